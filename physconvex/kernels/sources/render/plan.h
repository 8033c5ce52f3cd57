// Which polygons may be seen in which tile of the image.
#pragma once

#include "arithmetic.h"

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

inline Box bounds(const Scene& scene, int x0, int x1, int y0, int y1) {
    Box box{FAR, -FAR, FAR, -FAR};
    for (int y = y0; y < y1; ++y)
        for (int x = x0; x < x1; ++x) {
            const float* q = scene.coordinates + 2 * (static_cast<size_t>(y) * scene.width + x);
            box.u0 = std::min(box.u0, q[0]), box.u1 = std::max(box.u1, q[0]);
            box.v0 = std::min(box.v0, q[1]), box.v1 = std::max(box.v1, q[1]);
        }
    return box;
}

inline Box both(const Box& a, const Box& b) {
    return {std::min(a.u0, b.u0), std::max(a.u1, b.u1), std::min(a.v0, b.v0), std::max(a.v1, b.v1)};
}

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
