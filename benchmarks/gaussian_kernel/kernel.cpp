// Blending of Gaussians on the CPU: images and their gradients. Kerbl et al. 2023, eqs. 2-5.
//
//   α = min(opacity exp(-½ dᵀ Q d), 0.99), zero below 1/255;  w = α T;  features += w f;  T -= w  (T: from 1),
// over the Gaussians from the nearest to the farthest, d the distance of a pixel's centre from the projected centre
// [pixels], Q = (a, b; b, c) the inverse of the projected covariance. Tiles and rows as in physconvex/kernels/sources/render.

#include "arithmetic.h"

namespace {

struct Splats {
    int32_t width, height, count, threads;
    const float* centres;   // [count, 2] pixels, nearest first
    const float* conics;    // [count, 3] a, b, c
    const float* opacity;   // [count]
    const float* features;  // [count, 4]
};

struct Tiles {
    int columns, rows;
    std::vector<int32_t> starts, gaussians;
};

// Half the height and half the width of what is drawn: the ellipse dᵀ Q d ≤ 2 log(255 opacity).
bool extent(const Splats& s, int m, float& across, float& down) {
    const float most = s.opacity[m] / LEAST_ALPHA;
    const float *q = s.conics + 3 * m, area = q[0] * q[2] - q[1] * q[1];
    if (most <= 1.0f || area <= 0.0f) return false;
    const float reach = 2.0f * std::log(most) / area;
    across = std::sqrt(reach * q[2]), down = std::sqrt(reach * q[0]);
    return true;
}

Tiles sorted_into_tiles(const Splats& s) {
    Tiles tiles{(s.width + SIDE - 1) / SIDE, (s.height + SIDE - 1) / SIDE, {}, {}};
    tiles.starts.assign(tiles.columns * tiles.rows + 1, 0);
    auto each = [&](auto&& put) {
        for (int m = 0; m < s.count; ++m) {
            float across, down;
            if (!extent(s, m, across, down)) continue;
            const float x = s.centres[2 * m], y = s.centres[2 * m + 1];
            if (!(x + across >= 0 && y + down >= 0 && x - across <= s.width && y - down <= s.height)) continue;
            const int x0 = static_cast<int>(std::max(0.0f, x - across)) / SIDE;
            const int y0 = static_cast<int>(std::max(0.0f, y - down)) / SIDE;
            const int x1 = std::min(tiles.columns - 1, static_cast<int>(std::min(x + across, 1e6f)) / SIDE);
            const int y1 = std::min(tiles.rows - 1, static_cast<int>(std::min(y + down, 1e6f)) / SIDE);
            for (int j = y0; j <= y1; ++j)
                for (int i = x0; i <= x1; ++i) put(j * tiles.columns + i, m);
        }
    };
    each([&](int tile, int) { ++tiles.starts[tile + 1]; });
    for (size_t t = 1; t < tiles.starts.size(); ++t) tiles.starts[t] += tiles.starts[t - 1];
    tiles.gaussians.resize(tiles.starts.back());
    std::vector<int32_t> place(tiles.starts.begin(), tiles.starts.end() - 1);
    each([&](int tile, int m) { tiles.gaussians[place[tile]++] = m; });
    return tiles;
}

struct Sample {
    Row dx, dy, shape, alpha, weight, before;  // shape: exp(-½ dᵀ Q d)
};

// visit(m, row, first column, y, sample) for every row of a tile that a Gaussian may be seen in, front to back.
template <class Visit>
void walk(const Splats& s, const Tiles& tiles, int tile, float (*through)[LANES], Visit&& visit) {
    const int x0 = tile % tiles.columns * SIDE, y0 = tile / tiles.columns * SIDE;
    bool open[SIDE];
    int open_rows = 0;
    for (int row = 0; row < SIDE; ++row) {
        open_rows += open[row] = y0 + row < s.height;
        for (int l = 0; l < LANES; ++l) through[row][l] = open[row] && x0 + l < s.width ? 1.0f : 0.0f;
    }
    Sample sample;
    for (int e = tiles.starts[tile]; e < tiles.starts[tile + 1] && open_rows; ++e) {
        const int m = tiles.gaussians[e];
        float across, down;
        extent(s, m, across, down);
        const float a = s.conics[3 * m], b = s.conics[3 * m + 1], c = s.conics[3 * m + 2], strength = s.opacity[m];
        const float x = s.centres[2 * m], y = s.centres[2 * m + 1];
        const int first = std::max(0, static_cast<int>(std::floor(y - down - 0.5f)) - y0);
        const int last = std::min(SIDE - 1, static_cast<int>(std::ceil(std::min(y + down, 1e6f) - 0.5f)) - y0);
        for (int row = first; row <= last; ++row) {
            if (!open[row]) continue;
            const float dy = y0 + row + 0.5f - y;
            EACH_LANE {
                sample.dx[l] = x0 + l + 0.5f - x, sample.dy[l] = dy;
                const float d = sample.dx[l];
                sample.shape[l] = exponential(-0.5f * (a * d * d + c * dy * dy) - b * d * dy);
                const float alpha = std::min(strength * sample.shape[l], GREATEST_ALPHA);
                const bool seen = (alpha >= LEAST_ALPHA) & (through[row][l] >= LEAST_TRANSMITTANCE);
                sample.alpha[l] = seen ? alpha : 0.0f;
                sample.before[l] = through[row][l];
                sample.weight[l] = sample.alpha[l] * sample.before[l];
            }
            visit(m, row, sample);
            int passes = 0;
            for (int l = 0; l < LANES; ++l) {
                through[row][l] -= sample.weight[l];
                passes |= through[row][l] >= LEAST_TRANSMITTANCE;
            }
            if (!passes) open[row] = false, --open_rows;
        }
    }
}

}  // namespace

extern "C" {

// features [height, width, 4], transmittance [height, width]
void gs_blend(const Splats* s, float* features, float* transmittance) {
    const Tiles tiles = sorted_into_tiles(*s);
    in_parallel(tiles.columns * tiles.rows, s->threads, [&](int tile, int) {
        float through[SIDE][LANES], blended[SIDE][FEATURES][LANES] = {};
        walk(*s, tiles, tile, through, [&](int m, int row, const Sample& sample) {
            const float* f = s->features + FEATURES * m;
            for (int k = 0; k < FEATURES; ++k) EACH_LANE blended[row][k][l] += sample.weight[l] * f[k];
        });
        const int x0 = tile % tiles.columns * SIDE, y0 = tile / tiles.columns * SIDE;
        for (int row = 0; row < std::min(SIDE, s->height - y0); ++row)
            for (int l = 0; l < std::min(LANES, s->width - x0); ++l) {
                const size_t q = static_cast<size_t>(y0 + row) * s->width + x0 + l;
                for (int k = 0; k < FEATURES; ++k) features[FEATURES * q + k] = blended[row][k][l];
                transmittance[q] = through[row][l];
            }
    });
}

// Gradients of centres, conics, opacity, features (added to what is there; one thread adds after the other's tile).
void gs_gradient(const Splats* s, const float* features, const float* transmittance, const float* g_features,
                 const float* g_transmittance, float* g_centres, float* g_conics, float* g_opacity, float* g_colours) {
    const Tiles tiles = sorted_into_tiles(*s);
    constexpr int NUMBERS = 10;
    std::vector<double> sums(static_cast<size_t>(std::max(1, s->threads)) * s->count * NUMBERS, 0.0);
    in_parallel(tiles.columns * tiles.rows, s->threads, [&](int tile, int thread) {
        float through[SIDE][LANES], behind[SIDE][LANES] = {}, gradient[SIDE][FEATURES][LANES] = {};
        const int x0 = tile % tiles.columns * SIDE, y0 = tile / tiles.columns * SIDE;
        for (int row = 0; row < std::min(SIDE, s->height - y0); ++row)
            for (int l = 0; l < std::min(LANES, s->width - x0); ++l) {
                const size_t q = static_cast<size_t>(y0 + row) * s->width + x0 + l;
                behind[row][l] = transmittance[q] * g_transmittance[q];
                for (int k = 0; k < FEATURES; ++k) {
                    gradient[row][k][l] = g_features[FEATURES * q + k];
                    behind[row][l] += features[FEATURES * q + k] * gradient[row][k][l];
                }
            }
        walk(*s, tiles, tile, through, [&](int m, int row, const Sample& z) {
            const float *f = s->features + FEATURES * m, *q = s->conics + 3 * m, strength = s->opacity[m];
            Row along, found[NUMBERS];
            EACH_LANE along[l] = 0.0f;
            for (int k = 0; k < FEATURES; ++k) EACH_LANE {
                along[l] += f[k] * gradient[row][k][l];
                found[6 + k][l] = z.weight[l] * gradient[row][k][l];
            }
            EACH_LANE {
                behind[row][l] -= z.weight[l] * along[l];
                const bool moves = (z.alpha[l] > 0.0f) & (strength * z.shape[l] <= GREATEST_ALPHA);
                const float alpha = z.before[l] * along[l] - behind[row][l] / (1.0f - z.alpha[l]);
                const float kept = moves ? alpha * z.shape[l] : 0.0f, power = kept * strength;
                found[0][l] = power * (q[0] * z.dx[l] + q[1] * z.dy[l]);
                found[1][l] = power * (q[1] * z.dx[l] + q[2] * z.dy[l]);
                found[2][l] = -0.5f * power * z.dx[l] * z.dx[l];
                found[3][l] = -power * z.dx[l] * z.dy[l];
                found[4][l] = -0.5f * power * z.dy[l] * z.dy[l];
                found[5][l] = kept;
            }
            double* to = sums.data() + (static_cast<size_t>(thread) * s->count + m) * NUMBERS;
            for (int k = 0; k < NUMBERS; ++k) to[k] += sum(found[k]);
        });
    });
    for (int m = 0; m < s->count; ++m) {
        double total[NUMBERS] = {};
        for (int thread = 0; thread < std::max(1, s->threads); ++thread)
            for (int k = 0; k < NUMBERS; ++k)
                total[k] += sums[(static_cast<size_t>(thread) * s->count + m) * NUMBERS + k];
        for (int k = 0; k < 2; ++k) g_centres[2 * m + k] = total[k];
        for (int k = 0; k < 3; ++k) g_conics[3 * m + k] = total[2 + k];
        g_opacity[m] = total[5];
        for (int k = 0; k < FEATURES; ++k) g_colours[FEATURES * m + k] = total[6 + k];
    }
}
}
