// Which polygons may be seen in which tile of the image.
#pragma once

#include "arithmetic.h"

constexpr int BLOCK = 4;  // tiles of a block along each side
static_assert(BLOCK * BLOCK == LANES);

// Bounding boxes of the coordinates of pixels, side by side: a line is compared with all of them at once.
struct Boxes {
    Row u0, u1, v0, v1;

    Boxes() {
        EACH_LANE u0[l] = v0[l] = FAR, u1[l] = v1[l] = -FAR;
    }

    void include(int box, float u, float v) {
        u0[box] = std::min(u0[box], u), u1[box] = std::max(u1[box], u);
        v0[box] = std::min(v0[box], v), v1[box] = std::max(v1[box], v);
    }

    // Whether each box is one in which no line of a polygon keeps φ above its reach.
    void reached(const Scene& scene, int polygon, float reach, int32_t (&seen)[LANES]) const {
        EACH_LANE seen[l] = 1;
        for (int h = scene.starts[polygon]; h < scene.starts[polygon + 1]; ++h) {
            const float a = scene.lines[3 * h], b = scene.lines[3 * h + 1], c = scene.lines[3 * h + 2];
            EACH_LANE seen[l] &= std::min(a * u0[l], a * u1[l]) + std::min(b * v0[l], b * v1[l]) + c <= reach;
        }
    }
};

// Which polygons may be seen in which tile, in the order of the polygons.
struct Plan {
    int columns, rows;
    std::vector<float> reach;        // greatest φ at which a polygon is seen
    std::vector<int32_t> starts;     // tile t has the entries starts[t] to starts[t + 1]
    std::vector<int32_t> polygons;   // of each entry
};

inline Plan* make_plan(const Scene& scene) {
    auto* plan = new Plan;
    plan->columns = (scene.width + SIDE - 1) / SIDE, plan->rows = (scene.height + SIDE - 1) / SIDE;
    const int tiles = plan->columns * plan->rows;
    const int across = (plan->columns + BLOCK - 1) / BLOCK, blocks = across * ((plan->rows + BLOCK - 1) / BLOCK);
    std::vector<Boxes> of_tiles(blocks), of_blocks((blocks + LANES - 1) / LANES);
    for (int y = 0; y < scene.height; ++y)
        for (int x = 0; x < scene.width; ++x) {
            const float* q = scene.coordinates + 2 * (static_cast<size_t>(y) * scene.width + x);
            const int column = x / SIDE, row = y / SIDE, block = row / BLOCK * across + column / BLOCK;
            of_tiles[block].include(row % BLOCK * BLOCK + column % BLOCK, q[0], q[1]);
            of_blocks[block / LANES].include(block % LANES, q[0], q[1]);
        }
    plan->reach.resize(scene.polygons);
    constexpr int SHARE = 512;  // polygons of one piece of work
    const int shares = (scene.polygons + SHARE - 1) / SHARE;
    std::vector<std::vector<std::pair<int32_t, int32_t>>> found(shares);  // tile, polygon
    in_parallel(shares, scene.threads, [&](int share, int) {
        int32_t in_block[LANES], in_tile[LANES];
        for (int m = share * SHARE; m < std::min((share + 1) * SHARE, scene.polygons); ++m) {
            // opacity / (1 + exp(β φ)) ≥ 1/255  ⇔  φ ≤ log(255 opacity - 1) / β; with some slack for rounding
            const float most = scene.opacity[m] / LEAST_ALPHA - 1.0f;
            const float exact = most > 0.0f ? std::log(most) / scene.sharpness[m] : -FAR;
            const float reach = plan->reach[m] = exact + 1e-3f * (1.0f + std::abs(exact));
            if (most <= 0.0f) continue;
            for (int block = 0; block < blocks; ++block) {
                if (block % LANES == 0) of_blocks[block / LANES].reached(scene, m, reach, in_block);
                if (!in_block[block % LANES]) continue;
                of_tiles[block].reached(scene, m, reach, in_tile);
                for (int l = 0; l < LANES; ++l) {
                    const int x = block % across * BLOCK + l % BLOCK, y = block / across * BLOCK + l / BLOCK;
                    if (in_tile[l] && x < plan->columns && y < plan->rows)
                        found[share].emplace_back(y * plan->columns + x, m);
                }
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
