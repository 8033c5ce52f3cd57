// Contact forces of points that nodes carry: λ − R(y − S λ + λ/ρ), and Newton's equation for it in the nodes.
//
// The arithmetic is that of contact_problem.py in float64. S = B H Bᵀ, B the weights of the points, H the compliance of
// the nodes; R is the resolvent of the law of contact (contact_resolvent.py).

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "obstacle.h"

namespace {

// Row c of B times v
inline void carried(const int32_t* starts, const int32_t* carriers, const double* weights, int c, const double* v,
                    double* out) {
    out[0] = out[1] = out[2] = 0;
    for (int k = starts[c]; k < starts[c + 1]; ++k)
        for (int i = 0; i < 3; ++i) out[i] += weights[k] * v[3 * size_t(carriers[k]) + i];
}

struct Pairs {
    int32_t count, nodes;
    const int32_t *starts, *carriers, *obstacle;  // [count + 1], [starts[count]], [count]
    const double* weights;                        // [starts[count]]
    const double *areas, *free, *base, *holds;    // [count], [count][3], [count][3], [count]: ρ
    const Obstacle* obstacles;
    const double* compliance;                     // [nodes][3][nodes][3], symmetric
    double stiffness, smoothing, slip_velocity, step;

    // Bᵀ v
    void gather(const double* values, double* out) const {
        std::fill(out, out + 3 * size_t(nodes), 0.0);
        for (int c = 0; c < count; ++c)
            for (int k = starts[c]; k < starts[c + 1]; ++k)
                for (int i = 0; i < 3; ++i) out[3 * size_t(carriers[k]) + i] += weights[k] * values[3 * c + i];
    }
    // (B v) of a pair
    void spread(int c, const double* values, double (&out)[3]) const {
        carried(starts, carriers, weights, c, values, out);
    }
    // H v, by rows that count, H being symmetric
    void give(const double* values, double* out) const {
        const size_t size = 3 * size_t(nodes);
        std::fill(out, out + size, 0.0);
        for (size_t j = 0; j < size; ++j) {
            const double by = values[j], *row = compliance + j * size;
            if (by == 0) continue;
            for (size_t i = 0; i < size; ++i) out[i] += by * row[i];
        }
    }
};

// Normal force and its derivative by the depth at which the point would lie without it
void normal_force(const Pairs& p, int c, double depth, double& push, double& rise) {
    const double e = p.smoothing, full = p.stiffness * p.areas[c], ratio = full / p.holds[c];
    depth = std::max(depth, 0.0);
    const bool ramp = depth < e + 0.5 * ratio * e;
    const double left = ramp ? 2 * depth / (1 + std::sqrt(1 + 2 * ratio * depth / e))
                             : (depth + 0.5 * ratio * e) / (1 + ratio);
    const bool soft = left < e;
    push = full * (soft ? left * left / (2 * e) : left - e / 2);
    rise = full * (soft ? left / e : 1.0);
    rise /= 1 + rise / p.holds[c];
}

// Friction, its derivatives by the speed and by the normal force, and its ratio to the speed
void tangential_force(const Pairs& p, double friction, double push, double speed, double resistance, double (&out)[4]) {
    const double v = p.slip_velocity, most = friction * push, slows = most / resistance, steep = 1 + 2 * slows / v;
    const double root = std::sqrt(std::max(steep * steep - 4 * slows * speed / (v * v), 0.0));
    const double left = speed >= v + slows ? speed - slows : 2 * speed / (steep + root);
    const double y = std::min(left / v, 1.0), share = 2 * y - y * y, bend = 1 + slows * (2 - 2 * y) / v;
    out[0] = most * share;
    out[1] = resistance * (1 - 1 / bend);
    out[2] = friction * share / bend;
    out[3] = speed > 1e-12 * v ? out[0] / std::max(speed, 1e-300) : 2 * most / v / steep;
}

// R and its derivative for one pair at a place
void resolve(const Pairs& p, int c, const double (&place)[3], const double* force, double* left, double* slope) {
    const Obstacle& o = p.obstacles[p.obstacle[c]];
    double normal[3], speed = 0, along[3], depth = -gap_of(o, place, normal);
    double slip[3], straight = 0;
    for (int i = 0; i < 3; ++i) {
        const double given = force[i] / p.holds[c];
        depth -= given * normal[i];
        slip[i] = (place[i] + given - p.base[3 * c + i]) / p.step - o.velocity[i];
        straight += slip[i] * normal[i];
    }
    for (int i = 0; i < 3; ++i) slip[i] -= straight * normal[i], speed += slip[i] * slip[i];
    speed = std::sqrt(speed);
    double push, rise, rub[4];
    normal_force(p, c, depth, push, rise);
    tangential_force(p, o.friction, push, speed, p.holds[c] * p.step, rub);
    for (int i = 0; i < 3; ++i) along[i] = slip[i] / std::max(speed, 1e-300);
    for (int i = 0; i < 3; ++i) {
        left[i] = force[i] - (rub[0] * along[i] - push * normal[i]);
        for (int k = 0; k < 3; ++k) {
            const double across = normal[i] * normal[k], ahead = along[i] * along[k];
            slope[3 * i + k] = rise * across - rub[2] * rise * along[i] * normal[k] +
                               (rub[1] * ahead + rub[3] * ((i == k) - across - ahead)) / p.step;
        }
    }
}

void inverse(const double (&m)[3][3], double (&out)[3][3]) {
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) {
            const int a = (k + 1) % 3, b = (k + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
            out[i][k] = m[a][c] * m[b][d] - m[a][d] * m[b][c];
        }
    const double det = m[0][0] * out[0][0] + m[0][1] * out[1][0] + m[0][2] * out[2][0];
    for (auto& row : out)
        for (double& value : row) value /= det;
}

}  // namespace

extern "C" {

// B x [count][3].
void pc_carry(int32_t count, const int32_t* starts, const int32_t* carriers, const double* weights, const double* x,
              double* out) {
    for (int c = 0; c < count; ++c) carried(starts, carriers, weights, c, x, out + 3 * size_t(c));
}

// Sets near [obstacles][size] for those of some points that are in an obstacle at x or at `moved` [size][3].
void pc_contact_near(int32_t count, const int32_t* points, int32_t size, const double* x, const double* moved,
                     int32_t obstacles, const Obstacle* given, uint8_t* near) {
    double normal[3];
    for (int o = 0; o < obstacles; ++o)
        for (int n = 0; n < count; ++n) {
            const size_t at = 3 * size_t(points[n]);
            if (gap_of(given[o], x + at, normal) < 0 || gap_of(given[o], moved + at, normal) < 0)
                near[size_t(o) * size + points[n]] = 1;
        }
}

// Trace of each point's own block of S [count].
void pc_contact_own_compliance(const Pairs* given, double* out) {
    const Pairs& p = *given;
    const size_t size = 3 * size_t(p.nodes);
    for (int c = 0; c < p.count; ++c) {
        double sum = 0;
        for (int k = p.starts[c]; k < p.starts[c + 1]; ++k)
            for (int l = p.starts[c]; l < p.starts[c + 1]; ++l) {
                const double* block = p.compliance + 3 * (size_t(p.carriers[k]) * size + p.carriers[l]);
                sum += p.weights[k] * p.weights[l] * (block[0] + block[size + 1] + block[2 * size + 2]);
            }
        out[c] = sum;
    }
}

// λ − R(y − S λ + λ/ρ) of each pair [count][3], and the derivative of R by its argument [count][3][3].
void pc_contact_residual(const Pairs* given, const double* forces, double* left, double* slope) {
    const Pairs& p = *given;
    std::vector<double> room(6 * size_t(p.nodes));
    double *pull = room.data(), *moved = pull + 3 * size_t(p.nodes);
    p.gather(forces, pull);
    p.give(pull, moved);
    for (int c = 0; c < p.count; ++c) {
        double place[3];
        p.spread(c, moved, place);
        for (int i = 0; i < 3; ++i) place[i] = p.free[3 * c + i] - place[i];
        resolve(p, c, place, forces + 3 * c, left + 3 * c, slope + 9 * c);
    }
}

// With D = slope and A = 1 − D/ρ: −A⁻¹ left to `alone`, A⁻¹ D to `stiff`, the pairs that touch to `touching`, the nodes
// that carry them to `active`. How many these are comes back in `counts`.
void pc_contact_alone(const Pairs* given, const double* left, const double* slope, double* alone, double* stiff,
                      int32_t* touching, int32_t* active, int32_t* counts) {
    const Pairs& p = *given;
    std::vector<char> carries(p.nodes);
    counts[0] = counts[1] = 0;
    for (int c = 0; c < p.count; ++c) {
        double a[3][3], b[3][3];
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) a[i][k] = (i == k) - slope[9 * c + 3 * i + k] / p.holds[c];
        inverse(a, b);
        bool touches = false;
        for (int i = 0; i < 3; ++i) {
            double sum = 0;
            for (int k = 0; k < 3; ++k) sum += b[i][k] * left[3 * c + k];
            alone[3 * c + i] = -sum;
            for (int k = 0; k < 3; ++k) {
                double product = 0;
                for (int l = 0; l < 3; ++l) product += b[i][l] * slope[9 * c + 3 * l + k];
                stiff[9 * c + 3 * i + k] = product;
                touches |= product != 0;
            }
        }
        if (!touches) continue;
        touching[counts[0]++] = c;
        for (int k = p.starts[c]; k < p.starts[c + 1]; ++k) carries[p.carriers[k]] = 1;
    }
    for (int n = 0; n < p.nodes; ++n)
        if (carries[n]) active[counts[1]++] = n;
}

// Newton's equation of the pairs that touch, (1 + A⁻¹ D S) δ = −A⁻¹ (left + D S alone'), alone' that of the others:
// the matrix, transposed, and the right side.
void pc_contact_on_points(const Pairs* given, int32_t count, const int32_t* touching, const double* alone,
                          const double* stiff, double* matrix, double* right) {
    const Pairs& p = *given;
    const size_t size = 3 * size_t(count), all = 3 * size_t(p.nodes);
    std::vector<double> half(size * all), others(alone, alone + 3 * size_t(p.count)), room(2 * all);  // half: B H
    for (int n = 0; n < count; ++n) {
        const int c = touching[n];
        for (int i = 0; i < 3; ++i) {
            others[3 * c + i] = 0;
            double* to = half.data() + (3 * size_t(n) + i) * all;
            for (int k = p.starts[c]; k < p.starts[c + 1]; ++k) {
                const double weight = p.weights[k], *row = p.compliance + (3 * size_t(p.carriers[k]) + i) * all;
                for (size_t j = 0; j < all; ++j) to[j] += weight * row[j];
            }
        }
    }
    p.gather(others.data(), room.data());
    p.give(room.data(), room.data() + all);
    for (int n = 0; n < count; ++n) {
        const double* own = stiff + 9 * size_t(touching[n]);
        double place[3];
        p.spread(touching[n], room.data() + all, place);
        for (int i = 0; i < 3; ++i) {
            right[3 * n + i] = alone[3 * touching[n] + i];
            for (int k = 0; k < 3; ++k) right[3 * n + i] -= own[3 * i + k] * place[k];
        }
    }
    for (size_t j = 0; j < size; ++j)  // S is symmetric: its rows by the half of the other, one after the other
        for (int n = 0; n < count; ++n) {
            const double* own = stiff + 9 * size_t(touching[n]);
            double at[3], *to = matrix + j * size + 3 * n;
            p.spread(touching[n], half.data() + j * all, at);
            for (int i = 0; i < 3; ++i) to[i] = own[3 * i] * at[0] + own[3 * i + 1] * at[1] + own[3 * i + 2] * at[2];
        }
    for (size_t j = 0; j < size; ++j) matrix[j * size + j] += 1.0;
}

// The same in the nodes that carry them: with K = Bᵀ A⁻¹ D B, (1 + H K) m = H Bᵀ alone, m = H Bᵀ δ.
void pc_contact_on_nodes(const Pairs* given, int32_t touches, const int32_t* touching, int32_t count,
                         const int32_t* active, const double* alone, const double* stiff, double* matrix,
                         double* right) {
    const Pairs& p = *given;
    std::vector<int32_t> number(p.nodes, -1);
    for (int n = 0; n < count; ++n) number[active[n]] = n;
    std::vector<double> blocks(9 * size_t(count) * count);
    std::vector<char> there(size_t(count) * count);
    for (int t = 0; t < touches; ++t) {
        const int c = touching[t];
        for (int k = p.starts[c]; k < p.starts[c + 1]; ++k)
            for (int l = p.starts[c]; l < p.starts[c + 1]; ++l) {
                const size_t at = size_t(number[p.carriers[k]]) * count + number[p.carriers[l]];
                const double weight = p.weights[k] * p.weights[l];
                there[at] = 1;
                for (int i = 0; i < 9; ++i) blocks[9 * at + i] += weight * stiff[9 * c + i];
            }
    }
    const size_t size = 3 * size_t(count), all = 3 * size_t(p.nodes);
    std::vector<double> own(size * size);  // H among the active nodes
    for (int n = 0; n < count; ++n)
        for (int i = 0; i < 3; ++i) {
            const double* row = p.compliance + (3 * size_t(active[n]) + i) * all;
            double* to = own.data() + (3 * size_t(n) + i) * size;
            for (int m = 0; m < count; ++m) std::memcpy(to + 3 * m, row + 3 * size_t(active[m]), 3 * sizeof(double));
        }
    std::fill(matrix, matrix + size * size, 0.0);
    for (int n = 0; n < count; ++n)
        for (int m = 0; m < count; ++m) {
            const size_t at = size_t(n) * count + m;
            if (!there[at]) continue;
            const double *block = blocks.data() + 9 * at, *row = own.data() + 3 * size_t(n) * size;
            for (int k = 0; k < 3; ++k) {
                double* to = matrix + (3 * size_t(m) + k) * size;
                const double x = block[k], y = block[3 + k], z = block[6 + k];
                for (size_t j = 0; j < size; ++j) to[j] += x * row[j] + y * row[size + j] + z * row[2 * size + j];
            }
        }
    for (size_t j = 0; j < size; ++j) matrix[j * size + j] += 1.0;
    std::vector<double> room(2 * all);
    p.gather(alone, room.data());
    p.give(room.data(), room.data() + all);
    for (int n = 0; n < count; ++n) std::memcpy(right + 3 * n, &room[all + 3 * size_t(active[n])], 3 * sizeof(double));
}

// Change of the forces: `alone` less A⁻¹ D B m, m [count][3] of the active nodes; written over `alone`.
void pc_contact_expand(const Pairs* given, int32_t count, const int32_t* active, const double* found,
                       const double* stiff, double* alone) {
    const Pairs& p = *given;
    std::vector<double> moved(3 * size_t(p.nodes));
    for (int n = 0; n < count; ++n) std::memcpy(&moved[3 * size_t(active[n])], found + 3 * n, 3 * sizeof(double));
    for (int c = 0; c < p.count; ++c) {
        double place[3];
        p.spread(c, moved.data(), place);
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) alone[3 * c + i] -= stiff[9 * c + 3 * i + k] * place[k];
    }
}

// R M Rᵀ, block by block of 3 × 3, M [count][3][count][3] those blocks of a symmetric matrix [size][size] that belong to
// some places, and `more` [count][3][count][3], if not null, added.
void pc_turned_blocks(int32_t size, const double* matrix, int32_t count, const int32_t* places, const double* more,
                      const double* turn, double* out) {
    const size_t width = 3 * size_t(count);
    for (int n = 0; n < count; ++n)
        for (int m = 0; m < count; ++m) {
            const double* from = matrix + 3 * (size_t(places[n]) * size + places[m]);
            const double* extra = more ? more + 3 * (size_t(n) * width + m) : nullptr;
            double block[3][3], half[3][3];
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k) block[i][k] = from[i * size + k] + (extra ? extra[i * width + k] : 0.0);
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k)
                    half[i][k] = turn[3 * i] * block[0][k] + turn[3 * i + 1] * block[1][k] + turn[3 * i + 2] * block[2][k];
            double* to = out + 3 * (size_t(n) * width + m);
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k)
                    to[i * width + k] =
                        half[i][0] * turn[3 * k] + half[i][1] * turn[3 * k + 1] + half[i][2] * turn[3 * k + 2];
        }
}
}
