// Blending of soft-edged polygons on the CPU: images, their gradients, their directional derivatives.
//
// The arithmetic is that of reference.py in float32:
//   s_h = a_h u + b_h v + c_h,  φ = log Σ_h exp s_h,  occupancy o = 1 / (1 + exp(β φ)),
//   α = min(opacity o, 0.99), zero below 1/255;  w = α T;  features += w f;  T -= w  (T: transmittance, from 1),
// over the polygons from the nearest to the farthest. Pixels are drawn in tiles of 16 rows of 16, one row at once.
// φ ≥ max_h s_h, and s_h is linear, so polygons that cannot reach 1/255 in a tile or row are left out exactly.
// Every tile writes its own places, so results do not depend on the number of threads.

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <thread>
#include <vector>

namespace {

constexpr int SIDE = 16;      // pixels of a tile along each side
constexpr int LANES = SIDE;   // pixels of a row
constexpr int FEATURES = 4;   // red, green, blue, depth
constexpr float LEAST_ALPHA = 1.0f / 255.0f;
constexpr float GREATEST_ALPHA = 0.99f;
constexpr float LEAST_TRANSMITTANCE = 1e-4f;
constexpr float FAR = 1e30f;

using Row = float[LANES];

#define EACH_LANE _Pragma("omp simd") for (int l = 0; l < LANES; ++l)

}  // namespace

extern "C" {

// What is drawn; the layouts are those of `Splats` and of `View.pixel_coordinates`.
struct Scene {
    int32_t width, height, polygons, threads;
    const float* coordinates;  // [height, width, 2]
    const int32_t* starts;     // [polygons + 1]
    const float* lines;        // [L, 3]
    const float* sharpness;    // [polygons]
    const float* opacity;      // [polygons]
    const float* features;     // [polygons, 4]
};

}  // extern "C"

namespace {

inline float as_float(int32_t bits) { float x; std::memcpy(&x, &bits, sizeof x); return x; }
inline int32_t as_bits(float x) { int32_t bits; std::memcpy(&bits, &x, sizeof bits); return bits; }

// exp x = 2^n exp r with |r| ≤ log(2)/2, and its Taylor series to r^6: relative error below 2e-7.
inline float exponential(float x) {
    x = std::min(std::max(x, -87.0f), 88.0f);
    const float shifted = x * 1.44269504f + 12582912.0f;  // adding 1.5 · 2^23 leaves n in the lowest bits
    const float n = shifted - 12582912.0f;
    const float r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    float y = 1.0f / 720;
    y = y * r + 1.0f / 120;
    y = y * r + 1.0f / 24;
    y = y * r + 1.0f / 6;
    y = y * r + 0.5f;
    y = y * r + 1.0f;
    y = y * r + 1.0f;
    return y * as_float((as_bits(shifted) << 23) + 0x3f800000);
}

// log x = e log 2 + 2 artanh z, z = (m - 1) / (m + 1), for x = m 2^e with m from √½ to √2.
inline float logarithm(float x) {
    const int32_t bits = as_bits(x) - 0x3f3504f3;
    const int32_t exponent = bits >> 23;
    const float m = as_float((bits & 0x7fffff) + 0x3f3504f3);
    const float z = (m - 1.0f) / (m + 1.0f), q = z * z;
    const float series = 1.0f + q * (1.0f / 3 + q * (1.0f / 5 + q * (1.0f / 7 + q * (1.0f / 9))));
    return static_cast<float>(exponent) * 0.693147181f + 2.0f * z * series;
}

inline float sum(const Row x) {
    float total = 0.0f;
#pragma omp simd reduction(+ : total)
    for (int l = 0; l < LANES; ++l) total += x[l];
    return total;
}

template <class Work>  // work(item, thread)
void in_parallel(int items, int threads, const Work& work) {
    std::atomic<int> next{0};
    auto run = [&](int thread) {
        for (int item = next++; item < items; item = next++) work(item, thread);
    };
    std::vector<std::thread> others;
    for (int thread = 1; thread < std::min(threads, items); ++thread) others.emplace_back(run, thread);
    run(0);
    for (auto& other : others) other.join();
}

struct Box { float u0, u1, v0, v1; };

// Least value of a line's function over a box.
inline float least(const float* line, const Box& box) {
    return std::min(line[0] * box.u0, line[0] * box.u1) + std::min(line[1] * box.v0, line[1] * box.v1) + line[2];
}

inline bool reaches(const Scene& scene, int polygon, float reach, const Box& box) {
    for (int h = scene.starts[polygon]; h < scene.starts[polygon + 1]; ++h)
        if (least(scene.lines + 3 * h, box) > reach) return false;
    return true;
}

Box bounds(const Scene& scene, int x0, int x1, int y0, int y1) {
    Box box{FAR, -FAR, FAR, -FAR};
    for (int y = y0; y < y1; ++y)
        for (int x = x0; x < x1; ++x) {
            const float* q = scene.coordinates + 2 * (static_cast<size_t>(y) * scene.width + x);
            box.u0 = std::min(box.u0, q[0]), box.u1 = std::max(box.u1, q[0]);
            box.v0 = std::min(box.v0, q[1]), box.v1 = std::max(box.v1, q[1]);
        }
    return box;
}

Box both(const Box& a, const Box& b) {
    return {std::min(a.u0, b.u0), std::max(a.u1, b.u1), std::min(a.v0, b.v0), std::max(a.v1, b.v1)};
}

}  // namespace

extern "C" {

// Which polygons may be seen in which tile, in the order of the polygons.
struct Plan {
    int columns, rows;
    std::vector<float> reach;        // greatest φ at which a polygon is seen
    std::vector<int32_t> starts;     // tile t has the entries starts[t] to starts[t + 1]
    std::vector<int32_t> polygons;   // of each entry
};

Plan* pc_plan(const Scene* given) {
    const Scene& scene = *given;
    auto* plan = new Plan;
    plan->columns = (scene.width + SIDE - 1) / SIDE, plan->rows = (scene.height + SIDE - 1) / SIDE;
    const int tiles = plan->columns * plan->rows;
    std::vector<Box> box(tiles), row_box(plan->rows, {FAR, -FAR, FAR, -FAR}), column_box(plan->columns, row_box[0]);
    for (int tile = 0; tile < tiles; ++tile) {
        const int x = tile % plan->columns, y = tile / plan->columns;
        box[tile] = bounds(scene, x * SIDE, std::min((x + 1) * SIDE, scene.width), y * SIDE,
                           std::min((y + 1) * SIDE, scene.height));
        row_box[y] = both(row_box[y], box[tile]), column_box[x] = both(column_box[x], box[tile]);
    }
    plan->reach.resize(scene.polygons);
    constexpr int SHARE = 512;  // polygons of one piece of work
    const int shares = (scene.polygons + SHARE - 1) / SHARE;
    std::vector<std::vector<std::pair<int32_t, int32_t>>> found(shares);  // tile, polygon
    in_parallel(shares, scene.threads, [&](int share, int) {
        std::vector<int> columns;
        for (int m = share * SHARE; m < std::min((share + 1) * SHARE, scene.polygons); ++m) {
            // opacity / (1 + exp(β φ)) ≥ 1/255  ⇔  φ ≤ log(255 opacity - 1) / β; with some slack for rounding
            const float most = scene.opacity[m] / LEAST_ALPHA - 1.0f;
            const float exact = most > 0.0f ? std::log(most) / scene.sharpness[m] : -FAR;
            const float reach = plan->reach[m] = exact + 1e-3f * (1.0f + std::abs(exact));
            if (most <= 0.0f) continue;
            columns.clear();
            for (int x = 0; x < plan->columns; ++x)
                if (reaches(scene, m, reach, column_box[x])) columns.push_back(x);
            if (columns.empty()) continue;
            for (int y = 0; y < plan->rows; ++y) {
                if (!reaches(scene, m, reach, row_box[y])) continue;
                for (int x : columns)
                    if (reaches(scene, m, reach, box[y * plan->columns + x]))
                        found[share].emplace_back(y * plan->columns + x, m);
            }
        }
    });
    plan->starts.assign(tiles + 1, 0);
    for (auto& share : found)
        for (auto& entry : share) ++plan->starts[entry.first + 1];
    for (int tile = 0; tile < tiles; ++tile) plan->starts[tile + 1] += plan->starts[tile];
    plan->polygons.resize(plan->starts[tiles]);
    std::vector<int32_t> place(plan->starts.begin(), plan->starts.end() - 1);
    for (auto& share : found)
        for (auto& entry : share) plan->polygons[place[entry.first]++] = entry.second;
    return plan;
}

void pc_free(Plan* plan) { delete plan; }

}  // extern "C"

namespace {

// Gift wrapping. Products are compared, not subtracted, so that fusing them cannot change a sign.
void wrap(int points, const double* p, int64_t* order, int64_t* number) {
    int start = 0;
    for (int k = 1; k < points; ++k)
        if (p[2 * k + 1] < p[2 * start + 1] || (p[2 * k + 1] == p[2 * start + 1] && p[2 * k] < p[2 * start])) start = k;
    std::fill_n(order, points, 0);
    *number = 0;
    int current = start;
    do {
        order[(*number)++] = current;
        int best = 0;
        double x = p[0] - p[2 * current], y = p[1] - p[2 * current + 1];
        for (int k = 1; k < points; ++k) {
            const double u = p[2 * k] - p[2 * current], v = p[2 * k + 1] - p[2 * current + 1];
            const double left = x * v, right = y * u;
            if (left < right || (left == right && u * u + v * v > x * x + y * y)) best = k, x = u, y = v;
        }
        current = best;
    } while (*number < points && (p[2 * current] != p[2 * start] || p[2 * current + 1] != p[2 * start + 1]));
}

// The least, over sides, of the greatest distance of a point from that side.
double least_width(int points, const double* p, const int64_t* order, int corners) {
    if (corners < 3) return 0.0;
    double least = FAR;
    for (int c = 0; c < corners; ++c) {
        const double *a = p + 2 * order[c], *b = p + 2 * order[(c + 1) % corners];
        const double x = b[0] - a[0], y = b[1] - a[1];
        double greatest = 0.0;
        for (int k = 0; k < points; ++k)
            greatest = std::max(greatest, x * (p[2 * k + 1] - a[1]) - y * (p[2 * k] - a[0]));
        least = std::min(least, greatest / std::sqrt(x * x + y * y));
    }
    return least;
}

// One row of pixels under one polygon.
struct Sample {
    const float *u, *v;
    Row exp_sum, phi, occupancy, alpha, weight, before;  // before: transmittance in front of the polygon
    std::vector<float> exps;                             // exp(s_h - max s), [H][LANES]
};

// One tile: where its pixels look, and what still passes.
struct Tile {
    Row u[SIDE], v[SIDE], through[SIDE];
    Row u0, u1, v0, v1;  // bounds of each row
    bool open[SIDE];     // whether anything still passes in a row
    int x0, y0, columns, rows;
    Sample sample;

    void load(const Scene& scene, const Plan& plan, int tile) {
        x0 = tile % plan.columns * SIDE, y0 = tile / plan.columns * SIDE;
        columns = std::min(SIDE, scene.width - x0), rows = std::min(SIDE, scene.height - y0);
        for (int r = 0; r < SIDE; ++r) {
            open[r] = r < rows;
            const int y = y0 + std::min(r, rows - 1);
            for (int l = 0; l < LANES; ++l) {
                const int x = x0 + std::min(l, columns - 1);
                const float* q = scene.coordinates + 2 * (static_cast<size_t>(y) * scene.width + x);
                u[r][l] = q[0], v[r][l] = q[1];
                through[r][l] = l < columns && open[r] ? 1.0f : 0.0f;  // nothing is drawn beyond the image
            }
            u0[r] = *std::min_element(u[r], u[r] + LANES), u1[r] = *std::max_element(u[r], u[r] + LANES);
            v0[r] = *std::min_element(v[r], v[r] + LANES), v1[r] = *std::max_element(v[r], v[r] + LANES);
        }
    }

    size_t pixel(const Scene& scene, int row, int lane) const {
        return static_cast<size_t>(y0 + row) * scene.width + x0 + lane;
    }

    // Greatest, over the lines, of the least s_h in each row: a bound from below for φ.
    void bound(const float* lines, int count, Row low) const {
        EACH_LANE low[l] = -FAR;
        for (int h = 0; h < count; ++h) {
            const float a = lines[3 * h], b = lines[3 * h + 1], c = lines[3 * h + 2];
            EACH_LANE {
                const float s = std::min(a * u0[l], a * u1[l]) + std::min(b * v0[l], b * v1[l]) + c;
                low[l] = std::max(low[l], s);
            }
        }
    }

    // Fill the sample of a row; false if the polygon is not seen in it.
    bool draw(const float* lines, int count, float beta, float opacity, float reach, int row) {
        Sample& s = sample;
        if (s.exps.size() < static_cast<size_t>(count) * LANES) s.exps.resize(static_cast<size_t>(count) * LANES);
        float* exps = s.exps.data();
        s.u = u[row], s.v = v[row];
        Row most;
        EACH_LANE most[l] = -FAR;
        for (int h = 0; h < count; ++h) {
            const float a = lines[3 * h], b = lines[3 * h + 1], c = lines[3 * h + 2];
            float* e = exps + h * LANES;
            EACH_LANE {
                e[l] = a * s.u[l] + b * s.v[l] + c;
                most[l] = std::max(most[l], e[l]);
            }
        }
        int near = 0;
#pragma omp simd reduction(| : near)
        for (int l = 0; l < LANES; ++l) near |= (most[l] <= reach) & (through[row][l] >= LEAST_TRANSMITTANCE);
        if (!near) return false;
        EACH_LANE s.exp_sum[l] = 0.0f;
        for (int h = 0; h < count; ++h) {
            float* e = exps + h * LANES;
            EACH_LANE {
                e[l] = exponential(e[l] - most[l]);
                s.exp_sum[l] += e[l];
            }
        }
        EACH_LANE {
            s.phi[l] = most[l] + logarithm(s.exp_sum[l]);
            s.occupancy[l] = 1.0f / (1.0f + exponential(beta * s.phi[l]));
            const float alpha = std::min(opacity * s.occupancy[l], GREATEST_ALPHA);
            const bool seen = (alpha >= LEAST_ALPHA) & (through[row][l] >= LEAST_TRANSMITTANCE);
            s.alpha[l] = seen ? alpha : 0.0f;
            s.before[l] = through[row][l];
            s.weight[l] = s.alpha[l] * s.before[l];
        }
        return true;
    }
};

// Draw a tile front to back: visit.row(polygon, first line, lines, row, sample) wherever a polygon may be seen, between
// visit.open(entry, polygon) and visit.close(entry, polygon).
template <class Visitor>
void walk(const Scene& scene, const Plan& plan, int number, Tile& tile, Visitor& visit) {
    int open_rows = tile.rows;
    for (int entry = plan.starts[number]; entry < plan.starts[number + 1] && open_rows; ++entry) {
        const int m = plan.polygons[entry], first = scene.starts[m], count = scene.starts[m + 1] - first;
        const float* lines = scene.lines + 3 * first;
        Row low;
        tile.bound(lines, count, low);
        visit.open(entry, m);
        for (int row = 0; row < SIDE; ++row) {
            if (!tile.open[row] || low[row] > plan.reach[m]) continue;
            if (!tile.draw(lines, count, scene.sharpness[m], scene.opacity[m], plan.reach[m], row)) continue;
            visit.row(m, first, count, row, tile.sample);
            int passes = 0;
            float* through = tile.through[row];
            const float* weight = tile.sample.weight;
#pragma omp simd reduction(| : passes)
            for (int l = 0; l < LANES; ++l) {
                through[l] -= weight[l];
                passes |= through[l] >= LEAST_TRANSMITTANCE;
            }
            if (!passes) tile.open[row] = false, --open_rows;
        }
        visit.close(entry, m);
    }
}

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

// The hulls of hull.py: order [sets, points] (zero beyond number), number [sets], width [sets].
void pc_hulls(int32_t sets, int32_t points, int32_t threads, const double* given, int64_t* order, int64_t* number,
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
