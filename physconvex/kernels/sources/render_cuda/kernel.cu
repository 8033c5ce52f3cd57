// Blending of soft-edged polygons on a GPU, its gradient, its derivatives in some directions: the arithmetic of reference.py and of cpu/kernel.cpp.
//
// One block of 256 threads draws a tile of 16 × 16 pixels, one thread each. The polygons come nearest first; 256 at a
// time are tested against the tile (φ ≥ max_h s_h, and s_h is linear, so what cannot reach 1/255 is left out exactly),
// and those that may be seen are blended in their order.
#ifndef EMULATED  // the tests run this text on the CPU with their own of these two
__device__ bool any_in_warp(bool value) { return __any_sync(0xffffffffu, value); }

// *to += sum of value over the warp.
__device__ void add(float* to, float value) {
    for (int step = 16; step; step /= 2) value += __shfl_down_sync(0xffffffffu, value, step);
    if (threadIdx.x % 32 == 0 && value != 0.0f) atomicAdd(to, value);
}
#endif

constexpr int SIDE = 16, BLOCK = SIDE * SIDE, WORDS = BLOCK / 32, FEATURES = 4, DIRECTIONS = 8;
constexpr float LEAST_ALPHA = 1.0f / 255.0f, GREATEST_ALPHA = 0.99f, LEAST_TRANSMITTANCE = 1e-4f;

struct Scene {  // layouts as in cpu/arithmetic.h
    int width, height, polygons;
    const float* coordinates;
    const int* starts;
    const float *lines, *sharpness, *opacity, *features;
};

struct Sample {  // one pixel under one polygon
    float most, exp_sum, phi, occupancy, alpha, weight, before;
};

struct Pixel {
    int place;  // in the image, -1 beyond it
    float u, v, through;
};

__device__ bool reaches(const Scene& scene, int m, float u0, float u1, float v0, float v1) {
    // opacity / (1 + exp(β φ)) ≥ 1/255  ⇔  φ ≤ log(255 opacity - 1) / β; with some slack for rounding
    const float most = scene.opacity[m] / LEAST_ALPHA - 1.0f;
    if (most <= 0.0f) return false;
    const float exact = logf(most) / scene.sharpness[m], reach = exact + 1e-3f * (1.0f + fabsf(exact));
    for (int h = scene.starts[m]; h < scene.starts[m + 1]; ++h) {
        const float a = scene.lines[3 * h], b = scene.lines[3 * h + 1], c = scene.lines[3 * h + 2];
        if (fminf(a * u0, a * u1) + fminf(b * v0, b * v1) + c > reach) return false;
    }
    return true;
}

__device__ Sample sample(const Scene& scene, int m, const Pixel& pixel) {
    Sample s;
    s.most = -1e30f, s.exp_sum = 0.0f, s.before = pixel.through;
    const int first = scene.starts[m], last = scene.starts[m + 1];
    for (int h = first; h < last; ++h) {
        const float* line = scene.lines + 3 * h;
        s.most = fmaxf(s.most, line[0] * pixel.u + line[1] * pixel.v + line[2]);
    }
    for (int h = first; h < last; ++h) {
        const float* line = scene.lines + 3 * h;
        s.exp_sum += expf(line[0] * pixel.u + line[1] * pixel.v + line[2] - s.most);
    }
    s.phi = s.most + logf(s.exp_sum);
    s.occupancy = 1.0f / (1.0f + expf(fminf(scene.sharpness[m] * s.phi, 87.0f)));
    const float alpha = fminf(scene.opacity[m] * s.occupancy, GREATEST_ALPHA);
    s.alpha = alpha >= LEAST_ALPHA && pixel.through >= LEAST_TRANSMITTANCE ? alpha : 0.0f;
    s.weight = s.alpha * s.before;
    return s;
}

// Draw a tile front to back: visit(polygon, sample, pixel) wherever a warp may see a polygon.
template <class Visitor>
__device__ void walk(const Scene& scene, Pixel& pixel, Visitor& visit) {
    __shared__ float u0[BLOCK], u1[BLOCK], v0[BLOCK], v1[BLOCK];
    __shared__ unsigned words[WORDS];
    const int thread = threadIdx.x;
    u0[thread] = u1[thread] = pixel.u, v0[thread] = v1[thread] = pixel.v;
    for (int half = BLOCK / 2; half; half /= 2) {
        __syncthreads();
        if (thread >= half) continue;
        u0[thread] = fminf(u0[thread], u0[thread + half]), u1[thread] = fmaxf(u1[thread], u1[thread + half]);
        v0[thread] = fminf(v0[thread], v0[thread + half]), v1[thread] = fmaxf(v1[thread], v1[thread + half]);
    }
    for (int base = 0; base < scene.polygons; base += BLOCK) {
        if (thread < WORDS) words[thread] = 0;
        __syncthreads();
        const int candidate = base + thread;
        if (candidate < scene.polygons && reaches(scene, candidate, u0[0], u1[0], v0[0], v1[0]))
            atomicOr(&words[thread / 32], 1u << (thread % 32));
        __syncthreads();
        for (int word = 0; word < WORDS; ++word)
            for (unsigned bits = words[word]; bits; bits &= bits - 1) {
                const int m = base + 32 * word + __ffs(static_cast<int>(bits)) - 1;
                const Sample s = sample(scene, m, pixel);
                if (!any_in_warp(s.alpha > 0.0f)) continue;
                visit(m, s, pixel);
                pixel.through -= s.weight;
            }
        if (__syncthreads_and(pixel.through < LEAST_TRANSMITTANCE)) break;
    }
}

__device__ Pixel pixel_of(const Scene& scene) {
    const int thread = threadIdx.x;
    const int x = blockIdx.x * SIDE + thread % SIDE, y = blockIdx.y * SIDE + thread / SIDE;
    const bool inside = x < scene.width && y < scene.height;
    const int nearest = min(y, scene.height - 1) * scene.width + min(x, scene.width - 1);
    const float* q = scene.coordinates + 2 * nearest;
    return Pixel{inside ? nearest : -1, q[0], q[1], inside ? 1.0f : 0.0f};
}

struct Blend {
    const Scene& scene;
    float features[FEATURES], heaviest;
    int which;

    __device__ void operator()(int m, const Sample& s, const Pixel&) {
        for (int k = 0; k < FEATURES; ++k) features[k] += s.weight * scene.features[FEATURES * m + k];
        if (s.weight > heaviest) heaviest = s.weight, which = m;
    }
};

struct Gradient {  // the formulas stand in cpu/kernel.cpp
    const Scene& scene;
    float *g_lines, *g_sharpness, *g_opacity, *g_features;
    float features[FEATURES], behind, u, v;

    __device__ void operator()(int m, const Sample& s, const Pixel& pixel) {
        const float *f = scene.features + FEATURES * m, strength = scene.opacity[m];
        float along = 0.0f;
        for (int k = 0; k < FEATURES; ++k) {
            along += f[k] * features[k];
            add(g_features + FEATURES * m + k, s.weight * features[k]);
        }
        behind -= s.weight * along;
        const bool moves = s.alpha > 0.0f && strength * s.occupancy <= GREATEST_ALPHA;
        const float kept = moves ? s.before * along - behind / (1.0f - s.alpha) : 0.0f;
        const float slope = -kept * strength * s.occupancy * (1.0f - s.occupancy);
        add(g_opacity + m, kept * s.occupancy);
        add(g_sharpness + m, slope * s.phi);
        const float phi = slope * scene.sharpness[m] / s.exp_sum;
        for (int h = scene.starts[m]; h < scene.starts[m + 1]; ++h) {
            const float* line = scene.lines + 3 * h;
            const float g = phi * expf(line[0] * pixel.u + line[1] * pixel.v + line[2] - s.most);
            add(g_lines + 3 * h, g * pixel.u), add(g_lines + 3 * h + 1, g * pixel.v), add(g_lines + 3 * h + 2, g);
            u += g * line[0], v += g * line[1];
        }
    }
};

struct Tangent {
    const Scene& scene;
    int directions, line_count;
    const float *d_coordinates, *d_lines, *d_sharpness, *d_opacity, *d_features;
    float features[DIRECTIONS][FEATURES], through[DIRECTIONS];

    __device__ void operator()(int m, const Sample& s, const Pixel& pixel) {
        const float *f = scene.features + FEATURES * m, strength = scene.opacity[m];
        const bool moves = s.alpha > 0.0f && strength * s.occupancy <= GREATEST_ALPHA;
        const float with_strength = moves ? s.occupancy : 0.0f;
        const float slope = -with_strength * strength * (1.0f - s.occupancy);
        const float per_line = slope * scene.sharpness[m] / s.exp_sum;
        float change[DIRECTIONS] = {};  // of α by the lines and the coordinates
        for (int h = scene.starts[m]; h < scene.starts[m + 1]; ++h) {
            const float* line = scene.lines + 3 * h;
            const float e = per_line * expf(line[0] * pixel.u + line[1] * pixel.v + line[2] - s.most);
            for (int p = 0; p < directions; ++p) {
                const float* d = d_lines + 3 * (static_cast<long long>(p) * line_count + h);
                const float* q = d_coordinates + 2 * (p * pixels() + max(pixel.place, 0));
                change[p] += e * (d[0] * pixel.u + d[1] * pixel.v + d[2] + line[0] * q[0] + line[1] * q[1]);
            }
        }
        for (int p = 0; p < directions; ++p) {
            const long long place = static_cast<long long>(p) * scene.polygons + m;
            const float by_edge = slope * s.phi * d_sharpness[place] + change[p];
            const float d_alpha = with_strength * d_opacity[place] + by_edge;
            const float weight = d_alpha * s.before + s.alpha * through[p];
            through[p] -= weight;
            for (int k = 0; k < FEATURES; ++k)
                features[p][k] += weight * f[k] + s.weight * d_features[FEATURES * place + k];
        }
    }
    __device__ long long pixels() const { return static_cast<long long>(scene.width) * scene.height; }
};

extern "C" __global__ void blend(int width, int height, int polygons, const float* coordinates, const int* starts,
                                 const float* lines, const float* sharpness, const float* opacity,
                                 const float* features, float* blended, float* transmittance, int* heaviest) {
    const Scene scene{width, height, polygons, coordinates, starts, lines, sharpness, opacity, features};
    Pixel pixel = pixel_of(scene);
    Blend visit{scene, {0.0f, 0.0f, 0.0f, 0.0f}, 0.0f, -1};
    walk(scene, pixel, visit);
    if (pixel.place < 0) return;
    for (int k = 0; k < FEATURES; ++k) blended[FEATURES * pixel.place + k] = visit.features[k];
    transmittance[pixel.place] = pixel.through;
    heaviest[pixel.place] = visit.which;
}

// Gradients of the coordinates (written) and of lines, sharpness, opacity, features (added to zeros).
extern "C" __global__ void gradient(int width, int height, int polygons, const float* coordinates, const int* starts,
                                    const float* lines, const float* sharpness, const float* opacity,
                                    const float* features, const float* blended, const float* transmittance,
                                    const float* g_blended, const float* g_transmittance, float* g_coordinates,
                                    float* g_lines, float* g_sharpness, float* g_opacity, float* g_features) {
    const Scene scene{width, height, polygons, coordinates, starts, lines, sharpness, opacity, features};
    Pixel pixel = pixel_of(scene);
    Gradient visit{scene, g_lines, g_sharpness, g_opacity, g_features, {0.0f, 0.0f, 0.0f, 0.0f}, 0.0f, 0.0f, 0.0f};
    if (pixel.place >= 0) {
        visit.behind = transmittance[pixel.place] * g_transmittance[pixel.place];
        for (int k = 0; k < FEATURES; ++k) {
            visit.features[k] = g_blended[FEATURES * pixel.place + k];
            visit.behind += blended[FEATURES * pixel.place + k] * visit.features[k];
        }
    }
    walk(scene, pixel, visit);
    if (pixel.place < 0) return;
    g_coordinates[2 * pixel.place] = visit.u;
    g_coordinates[2 * pixel.place + 1] = visit.v;
}

// Derivatives of the image in at most `DIRECTIONS` directions: every d_ array has the directions first.
extern "C" __global__ void tangent(int width, int height, int polygons, const float* coordinates, const int* starts,
                                   const float* lines, const float* sharpness, const float* opacity,
                                   const float* features, int directions, int line_count, const float* d_coordinates,
                                   const float* d_lines, const float* d_sharpness, const float* d_opacity,
                                   const float* d_features, float* d_blended, float* d_transmittance) {
    const Scene scene{width, height, polygons, coordinates, starts, lines, sharpness, opacity, features};
    Pixel pixel = pixel_of(scene);
    Tangent visit{scene, directions, line_count, d_coordinates, d_lines, d_sharpness, d_opacity, d_features, {}, {}};
    walk(scene, pixel, visit);
    if (pixel.place < 0) return;
    for (int p = 0; p < directions; ++p) {
        const long long place = p * visit.pixels() + pixel.place;
        d_transmittance[place] = visit.through[p];
        for (int k = 0; k < FEATURES; ++k) d_blended[FEATURES * place + k] = visit.features[p][k];
    }
}
