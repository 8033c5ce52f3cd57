// One tile of the image, drawn front to back.
#pragma once

#include "plan.h"

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
