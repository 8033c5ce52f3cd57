// Blending of soft-edged polygons on the CPU: images, their gradients, their directional derivatives.
//
// The arithmetic is that of reference.py in float32:
//   s_h = a_h u + b_h v + c_h,  φ = log Σ_h exp s_h,  occupancy o = 1 / (1 + exp(β φ)),
//   α = min(opacity o, 0.99), zero below 1/255;  w = α T;  features += w f;  T -= w  (T: transmittance, from 1),
// over the polygons from the nearest to the farthest. Pixels are drawn in tiles of 16 rows of 16, one row at once.
// φ ≥ max_h s_h, and s_h is linear, so polygons that cannot reach 1/255 in a tile or row are left out exactly.
// Every tile writes its own places, so results do not depend on the number of threads.

#include "hulls.h"
#include "tile.h"

namespace {

struct Blend {  // features, and which polygon weighs most
    const Scene& scene;
    Row features[SIDE][FEATURES], heaviest[SIDE];
    int32_t which[SIDE][LANES];

    void open(int, int) {}
    void close(int, int) {}
    void row(int m, int, int, int row, const Sample& s) {
        const float* f = scene.features + FEATURES * m;
        for (int k = 0; k < FEATURES; ++k) EACH_LANE features[row][k][l] += s.weight[l] * f[k];
        EACH_LANE {
            const bool more = s.weight[l] > heaviest[row][l];
            heaviest[row][l] = more ? s.weight[l] : heaviest[row][l];
            which[row][l] = more ? m : which[row][l];
        }
    }
};

// Gradient of a loss. With g the gradient of the features, R_i = Σ_(j>i) w_j f_j·g + T_end g_T what lies behind polygon i:
//   ∂/∂α_i = T_i f_i·g - R_i / (1 - α_i),  ∂/∂φ_i = -β o (1 - o) opacity ∂/∂α_i,  ∂/∂s_h = softmax_h ∂/∂φ_i.
struct Gradient {
    const Scene& scene;
    const std::vector<size_t>& places;  // where the numbers of an entry begin: lines, sharpness, opacity, features
    float* slots;
    Row features[SIDE][FEATURES], behind[SIDE];  // gradient of the features; R
    Row u[SIDE], v[SIDE];                        // gradient of the coordinates
    Row sharpness, opacity, feature[FEATURES];
    std::vector<float> lines;  // [count][3][LANES]
    bool drawn;

    void open(int, int m) {
        const size_t size = static_cast<size_t>(scene.starts[m + 1] - scene.starts[m]) * 3 * LANES;
        lines.assign(size, 0.0f);
        std::memset(sharpness, 0, sizeof sharpness), std::memset(opacity, 0, sizeof opacity);
        std::memset(feature, 0, sizeof feature);
        drawn = false;
    }
    void close(int entry, int m) {
        if (!drawn) return;
        float* slot = slots + places[entry];
        const int count = 3 * (scene.starts[m + 1] - scene.starts[m]);
        for (int k = 0; k < count; ++k) slot[k] = sum(lines.data() + k * LANES);
        slot[count] = sum(sharpness), slot[count + 1] = sum(opacity);
        for (int k = 0; k < FEATURES; ++k) slot[count + 2 + k] = sum(feature[k]);
    }
    void row(int m, int first, int count, int row, const Sample& s) {
        drawn = true;
        const float* f = scene.features + FEATURES * m;
        const float strength = scene.opacity[m], beta = scene.sharpness[m];
        Row phi, along;
        EACH_LANE along[l] = 0.0f;
        for (int k = 0; k < FEATURES; ++k) EACH_LANE {
            along[l] += f[k] * features[row][k][l];
            feature[k][l] += s.weight[l] * features[row][k][l];
        }
        EACH_LANE {
            behind[row][l] -= s.weight[l] * along[l];
            const bool moves = (s.alpha[l] > 0.0f) & (strength * s.occupancy[l] <= GREATEST_ALPHA);
            const float alpha = s.before[l] * along[l] - behind[row][l] / (1.0f - s.alpha[l]);
            const float kept = moves ? alpha : 0.0f;
            opacity[l] += kept * s.occupancy[l];
            const float slope = -kept * strength * s.occupancy[l] * (1.0f - s.occupancy[l]);
            sharpness[l] += slope * s.phi[l];
            phi[l] = slope * beta / s.exp_sum[l];
        }
        for (int h = 0; h < count; ++h) {
            const float *line = scene.lines + 3 * (first + h), *e = s.exps.data() + h * LANES;
            const float a = line[0], b = line[1];
            float* to = lines.data() + 3 * LANES * h;
            EACH_LANE {
                const float g = phi[l] * e[l];
                to[l] += g * s.u[l];
                to[LANES + l] += g * s.v[l];
                to[2 * LANES + l] += g;
                u[row][l] += g * a;
                v[row][l] += g * b;
            }
        }
    }
};

// Derivatives in several directions at once.
struct Tangent {
    const Scene& scene;
    int directions;
    size_t line_count;
    const float *d_coordinates, *d_lines, *d_sharpness, *d_opacity, *d_features;
    const Tile& tile;
    std::vector<float> features, through;  // [direction][SIDE][FEATURES][LANES], [direction][SIDE][LANES]

    void open(int, int) {}
    void close(int, int) {}
    void row(int m, int first, int count, int row, const Sample& s) {
        const float* f = scene.features + FEATURES * m;
        const float strength = scene.opacity[m], beta = scene.sharpness[m];
        Row slope, moves, a, b;
        EACH_LANE {
            const bool free = (s.alpha[l] > 0.0f) & (strength * s.occupancy[l] <= GREATEST_ALPHA);
            moves[l] = free ? s.occupancy[l] : 0.0f;
            slope[l] = -moves[l] * strength * (1.0f - s.occupancy[l]);
            a[l] = b[l] = 0.0f;
        }
        if (d_coordinates)
            for (int h = 0; h < count; ++h) {
                const float *line = scene.lines + 3 * (first + h), *e = s.exps.data() + h * LANES;
                const float la = line[0], lb = line[1];
                EACH_LANE a[l] += e[l] * la, b[l] += e[l] * lb;
            }
        for (int p = 0; p < directions; ++p) {
            const size_t place = static_cast<size_t>(p) * scene.polygons + m;
            Row phi;
            EACH_LANE phi[l] = 0.0f;
            for (int h = 0; h < count; ++h) {
                const float* line = d_lines + 3 * (p * line_count + first + h);
                const float *e = s.exps.data() + h * LANES, da = line[0], db = line[1], dc = line[2];
                EACH_LANE phi[l] += e[l] * (da * s.u[l] + db * s.v[l] + dc);
            }
            if (d_coordinates) {
                const size_t base = static_cast<size_t>(p) * scene.width * scene.height;
                for (int l = 0; l < tile.columns; ++l) {
                    const float* q = d_coordinates + 2 * (base + tile.pixel(scene, row, l));
                    phi[l] += a[l] * q[0] + b[l] * q[1];
                }
            }
            const float d_beta = d_sharpness[place], d_strength = d_opacity[place];
            const float* df = d_features + FEATURES * place;
            float* passing = through.data() + (static_cast<size_t>(p) * SIDE + row) * LANES;
            float* blended = features.data() + (static_cast<size_t>(p) * SIDE + row) * FEATURES * LANES;
            Row weight;
            EACH_LANE {
                const float d_alpha = moves[l] * d_strength + slope[l] * (d_beta * s.phi[l] + beta * phi[l] / s.exp_sum[l]);
                weight[l] = d_alpha * s.before[l] + s.alpha[l] * passing[l];
                passing[l] -= weight[l];
            }
            for (int k = 0; k < FEATURES; ++k)
                EACH_LANE blended[k * LANES + l] += weight[l] * f[k] + s.weight[l] * df[k];
        }
    }
};

}  // namespace

extern "C" {

Plan* pc_plan(const Scene* scene) { return make_plan(*scene); }

void pc_free(Plan* plan) { delete plan; }

// The hulls of hull.py: order [sets, points] (zero beyond number), number [sets], width [sets].
void pc_hulls(int32_t sets, int32_t points, int32_t threads, const double* given, long long* order, long long* number,
              double* width) {
    constexpr int SHARE = 1024;
    in_parallel((sets + SHARE - 1) / SHARE, threads, [&](int share, int) {
        for (int set = share * SHARE; set < std::min((share + 1) * SHARE, sets); ++set) {
            const size_t base = static_cast<size_t>(set) * points;
            const double* p = given + 2 * base;
            wrap(points, p, order + base, number + set);
            width[set] = least_width(points, p, order + base, static_cast<int>(number[set]));
        }
    });
}

// features [height, width, 4], transmittance [height, width], heaviest [height, width]
void pc_blend(const Scene* given, const Plan* plan, float* features, float* transmittance, int32_t* heaviest) {
    const Scene& scene = *given;
    in_parallel(plan->columns * plan->rows, scene.threads, [&](int number, int) {
        Tile tile;
        tile.load(scene, *plan, number);
        Blend blend{scene, {}, {}, {}};
        std::memset(blend.which, -1, sizeof blend.which);
        walk(scene, *plan, number, tile, blend);
        for (int row = 0; row < tile.rows; ++row)
            for (int l = 0; l < tile.columns; ++l) {
                const size_t q = tile.pixel(scene, row, l);
                for (int k = 0; k < FEATURES; ++k) features[FEATURES * q + k] = blend.features[row][k][l];
                transmittance[q] = tile.through[row][l];
                heaviest[q] = blend.which[row][l];
            }
    });
}

// From the image and a gradient with respect to it, the gradients with respect to what it was made from (overwritten).
void pc_gradient(const Scene* given, const Plan* plan, const float* features, const float* transmittance,
                 const float* g_features, const float* g_transmittance, float* g_coordinates, float* g_lines,
                 float* g_sharpness, float* g_opacity, float* g_polygon_features) {
    const Scene& scene = *given;
    const size_t entries = plan->polygons.size();
    std::vector<size_t> places(entries + 1, 0);
    for (size_t entry = 0; entry < entries; ++entry) {
        const int m = plan->polygons[entry];
        places[entry + 1] = places[entry] + 3 * (scene.starts[m + 1] - scene.starts[m]) + 2 + FEATURES;
    }
    std::vector<float> slots(places[entries], 0.0f);
    in_parallel(plan->columns * plan->rows, scene.threads, [&](int number, int) {
        Tile tile;
        tile.load(scene, *plan, number);
        Gradient gradient{scene, places, slots.data(), {}, {}, {}, {}, {}, {}, {}, {}, false};
        for (int row = 0; row < tile.rows; ++row)
            for (int l = 0; l < tile.columns; ++l) {
                const size_t q = tile.pixel(scene, row, l);
                float total = transmittance[q] * g_transmittance[q];
                for (int k = 0; k < FEATURES; ++k) {
                    gradient.features[row][k][l] = g_features[FEATURES * q + k];
                    total += features[FEATURES * q + k] * g_features[FEATURES * q + k];
                }
                gradient.behind[row][l] = total;
            }
        walk(scene, *plan, number, tile, gradient);
        for (int row = 0; row < tile.rows; ++row)
            for (int l = 0; l < tile.columns; ++l) {
                float* q = g_coordinates + 2 * tile.pixel(scene, row, l);
                q[0] = gradient.u[row][l], q[1] = gradient.v[row][l];
            }
    });
    std::fill_n(g_lines, 3 * static_cast<size_t>(scene.starts[scene.polygons]), 0.0f);
    std::fill_n(g_sharpness, scene.polygons, 0.0f);
    std::fill_n(g_opacity, scene.polygons, 0.0f);
    std::fill_n(g_polygon_features, FEATURES * static_cast<size_t>(scene.polygons), 0.0f);
    for (size_t entry = 0; entry < entries; ++entry) {
        const int m = plan->polygons[entry], count = 3 * (scene.starts[m + 1] - scene.starts[m]);
        const float* slot = slots.data() + places[entry];
        for (int k = 0; k < count; ++k) g_lines[3 * static_cast<size_t>(scene.starts[m]) + k] += slot[k];
        g_sharpness[m] += slot[count], g_opacity[m] += slot[count + 1];
        for (int k = 0; k < FEATURES; ++k) g_polygon_features[FEATURES * m + k] += slot[count + 2 + k];
    }
}

// Derivatives of the image in several directions: every d_ array has the directions first; d_coordinates may be null.
void pc_tangent(const Scene* given, const Plan* plan, int32_t directions, const float* d_coordinates,
                const float* d_lines, const float* d_sharpness, const float* d_opacity, const float* d_polygon_features,
                float* d_features, float* d_transmittance) {
    const Scene& scene = *given;
    const size_t pixels = static_cast<size_t>(scene.width) * scene.height;
    in_parallel(plan->columns * plan->rows, scene.threads, [&](int number, int) {
        Tile tile;
        tile.load(scene, *plan, number);
        Tangent tangent{scene, directions, static_cast<size_t>(scene.starts[scene.polygons]), d_coordinates, d_lines,
                        d_sharpness, d_opacity, d_polygon_features, tile, {}, {}};
        tangent.features.assign(static_cast<size_t>(directions) * SIDE * FEATURES * LANES, 0.0f);
        tangent.through.assign(static_cast<size_t>(directions) * SIDE * LANES, 0.0f);
        walk(scene, *plan, number, tile, tangent);
        for (int p = 0; p < directions; ++p)
            for (int row = 0; row < tile.rows; ++row)
                for (int l = 0; l < tile.columns; ++l) {
                    const size_t q = p * pixels + tile.pixel(scene, row, l), r = static_cast<size_t>(p) * SIDE + row;
                    d_transmittance[q] = tangent.through[r * LANES + l];
                    for (int k = 0; k < FEATURES; ++k)
                        d_features[FEATURES * q + k] = tangent.features[(r * FEATURES + k) * LANES + l];
                }
    });
}

}  // extern "C"
