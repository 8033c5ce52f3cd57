// A reduced body in float64: energy, forces and the parts of the stiffness of the laws Ψ = μ/2 (I₁ - 3) + f(J), as
// volumetric.py; Kelvin-Voigt viscosity, as body.py; contact of the surface, as surface_contact.py.
//
// Samples come in blocks of LANES: F, stress and forces of a block stay in registers and the first cache, so that the
// gradients are read from memory once. Rows of F belong to components of the displacement, columns to directions.

#include <vector>

#include "obstacle.h"
#include "volumetric.h"

namespace {

struct alignas(sizeof(Lanes)) Line {
    double lanes[LANES];
};

struct Body {
    int32_t samples, functions, logarithmic;  // law: 0 neo_hookean, 1 neo_hookean_log
    double flat;                       // |J| over |C|^(3/2) below which a division by J costs digits
    const double* blocks;              // [samples / LANES, rounded up][functions][3][LANES]: ∂N_a/∂X_j
    const double* gradients;           // [samples][3][functions]: the same
    const double *weights, *mu, *lam;  // [samples]
};

inline Term<double> term(const Body& body, int q, double j) {
    return volume_term(body.logarithmic, j, body.mu[q], body.lam[q]);
}

// Σ_a y_a ⊗ ∂N_a/∂X of a block of samples, and what stresses there do to the coordinates.
struct Gradients {
    const Lanes* blocks;
    int functions;

    Gradients(const Body& body, int first)
        : blocks(reinterpret_cast<const Lanes*>(body.blocks) + size_t(3) * body.functions * (first / LANES)),
          functions(body.functions) {}

    void apply(const double* y, Lanes (&out)[3][3]) const {
        Lanes sum[3][3] = {};
        const Lanes* g = blocks;
        for (int a = 0; a < functions; ++a, g += 3, y += 3)
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k) sum[i][k] += y[i] * g[k];
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) out[i][k] = sum[i][k];
    }
    void collect(const Lanes (&stress)[3][3], Lanes* parts) const {
        const Lanes* g = blocks;
        for (int a = 0; a < functions; ++a, g += 3, parts += 3)
            for (int i = 0; i < 3; ++i) parts[i] += dot(stress[i], g);
    }
};

// Forces by lanes, until they are added up
struct Forces {
    std::vector<Line> room;

    explicit Forces(int functions) : room(3 * size_t(functions)) {}
    Lanes* parts() { return reinterpret_cast<Lanes*>(room.data()); }
    void store(double* forces) {
        for (size_t n = 0; n < room.size(); ++n) forces[n] = total(parts()[n]);
    }
};

// F, C = cof F and J of a block of samples.
struct Deformation {
    Gradients gradients;
    Lanes f[3][3], c[3][3], j;

    Deformation(const Body& body, int first, const double* y) : gradients(body, first) {
        gradients.apply(y, f);
        cofactor(f, c);
        j = dot(f[0], c[0]);
    }
};

// Viscosity of a block of samples at F*, with their weights
struct Viscosity {
    Gradients gradients;
    Lanes state[3][3] = {}, mu = {}, lam = {};

    Viscosity(const Body& body, int first, const double* given, double time) : gradients(body, first) {
        for (int l = 0; l < LANES && first + l < body.samples; ++l) {
            const int q = first + l;
            for (int n = 0; n < 9; ++n) state[n / 3][n % 3][l] = given[9 * size_t(q) + n];
            mu[l] = time * body.weights[q] * body.mu[q], lam[l] = time * body.weights[q] * body.lam[q];
        }
    }
    // Adds 2 μ sym AᵀB + λ tr AᵀB
    void resist(const Lanes (&a)[3][3], const Lanes (&b)[3][3], Lanes (&out)[3][3]) const {
        Lanes product[3][3];
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k) product[j][k] = a[0][j] * b[0][k] + a[1][j] * b[1][k] + a[2][j] * b[2][k];
        const Lanes pressure = lam * (product[0][0] + product[1][1] + product[2][2]);
        for (int j = 0; j < 3; ++j) {
            for (int k = 0; k < 3; ++k) out[j][k] += mu * (product[j][k] + product[k][j]);
            out[j][j] += pressure;
        }
    }
};

inline void add_product(const Lanes (&a)[3][3], const Lanes (&b)[3][3], Lanes (&out)[3][3]) {
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) out[i][k] += a[i][0] * b[0][k] + a[i][1] * b[1][k] + a[i][2] * b[2][k];
}

struct Surface {
    int32_t samples, functions, obstacles;
    const double* blocks;  // [samples / LANES, rounded up][functions][LANES]: N_a
    const double* areas;   // [samples]
    double stiffness, smoothing;
};

}  // namespace

extern "C" {

int32_t pc_lanes() { return LANES; }

// Elastic energy; its derivative by y [functions][3] goes to forces [functions][3].
double pc_energy_and_forces(const Body* given, const double* y, double* forces) {
    const Body& body = *given;
    Forces found(body.functions);
    Lanes energies = {};
    for (int first = 0; first < body.samples; first += LANES) {
        const Deformation at(body, first, y);
        const Lanes squared = square(at.f);
        Lanes linear = {}, slopes = {};  // nothing where the last block has no sample
        for (int l = 0; l < LANES && first + l < body.samples; ++l) {
            const int q = first + l;
            const Term<double> f = term(body, q, at.j[l]);
            linear[l] = body.weights[q] * body.mu[q], slopes[l] = body.weights[q] * f.slope;
            energies[l] += 0.5 * linear[l] * (squared[l] - 3) + body.weights[q] * f.value;
        }
        Lanes stress[3][3];
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) stress[i][k] = linear * at.f[i][k] + slopes * at.c[i][k];
        at.gradients.collect(stress, found.parts());
    }
    found.store(forces);
    return total(energies);
}

// Rate potential of Kelvin-Voigt viscosities time × (μ, λ), frozen at F* = state [samples][3][3]; its derivative by the
// velocities of the coordinates [functions][3] goes to forces.
double pc_viscous_power(const Body* given, const double* state, double time, const double* velocity, double* forces) {
    const Body& body = *given;
    Forces found(body.functions);
    Lanes powers = {};
    for (int first = 0; first < body.samples; first += LANES) {
        const Viscosity at(body, first, state, time);
        Lanes rate[3][3], inner[3][3] = {}, stress[3][3] = {};
        at.gradients.apply(velocity, rate);
        at.resist(at.state, rate, inner);
        add_product(at.state, inner, stress);
        for (int i = 0; i < 3; ++i) powers += 0.5 * dot(stress[i], rate[i]);
        at.gradients.collect(stress, found.parts());
    }
    found.store(forces);
    return total(powers);
}

// Derivative of these forces where F* moves as the coordinates do by step, and the velocities by speed_up.
void pc_viscous_tangent(const Body* given, const double* state, double time, const double* velocity, const double* step,
                        const double* speed_up, double* forces) {
    const Body& body = *given;
    Forces found(body.functions);
    for (int first = 0; first < body.samples; first += LANES) {
        const Viscosity at(body, first, state, time);
        Lanes rate[3][3], moved[3][3], faster[3][3], inner[3][3] = {}, change[3][3] = {}, stress[3][3] = {};
        at.gradients.apply(velocity, rate);
        at.gradients.apply(step, moved);
        at.gradients.apply(speed_up, faster);
        at.resist(at.state, rate, inner);
        at.resist(moved, rate, change);
        at.resist(at.state, faster, change);
        add_product(moved, inner, stress);
        add_product(at.state, change, stress);
        at.gradients.collect(stress, found.parts());
    }
    found.store(forces);
}

// Rows r of the viscosity's stiffness Σ r rᵀ for count samples from first on, rows [count][6][3][functions], components
// first: with e = ∂Ė/∂ẏ, 2 μ e : e + λ (tr e)² is a sum of squares, √(2 μ) e_jj + (√(2 μ + 3 λ) − √(2 μ))/3 tr e and
// 2 √μ e_jk.
void pc_viscous_rows(const Body* given, int32_t first, int32_t count, const double* state, double ratio, double* rows) {
    const Body& body = *given;
    const size_t size = body.functions;
    for (int q = first; q < first + count; ++q) {
        const double *g = body.gradients + 3 * size * q, *at = state + 9 * size_t(q);
        const double mu = ratio * body.weights[q] * body.mu[q], lam = ratio * body.weights[q] * body.lam[q];
        const double root = std::sqrt(2 * mu), mean = (std::sqrt(2 * mu + 3 * lam) - root) / 3, shear = std::sqrt(mu);
        for (int i = 0; i < 3; ++i, rows += size) {
            const double *f = at + 3 * i, *g0 = g, *g1 = g + size, *g2 = g + 2 * size;
            for (size_t a = 0; a < size; ++a) {
                const double e0 = f[0] * g0[a], e1 = f[1] * g1[a], e2 = f[2] * g2[a], trace = mean * (e0 + e1 + e2);
                rows[a] = root * e0 + trace;
                rows[3 * size + a] = root * e1 + trace;
                rows[6 * size + a] = root * e2 + trace;
                rows[9 * size + a] = shear * (f[0] * g1[a] + f[1] * g0[a]);
                rows[12 * size + a] = shear * (f[0] * g2[a] + f[2] * g0[a]);
                rows[15 * size + a] = shear * (f[1] * g2[a] + f[2] * g1[a]);
            }
        }
        rows += 15 * size;
    }
}

// Energy of contact of a surface, and its derivative by the coordinates.
double pc_surface_contact(const Surface* given, const Obstacle* obstacles, const double* y, double* forces) {
    const Surface& surface = *given;
    Forces found(surface.functions);
    double energy = 0;
    const Lanes* values = reinterpret_cast<const Lanes*>(surface.blocks);
    for (int first = 0; first < surface.samples; first += LANES, values += surface.functions) {
        Lanes place[3] = {}, force[3] = {};
        for (int a = 0; a < surface.functions; ++a)
            for (int i = 0; i < 3; ++i) place[i] += y[3 * a + i] * values[a];
        bool touched = false;
        for (int l = 0; l < LANES && first + l < surface.samples; ++l) {
            const double area = surface.areas[first + l], at[3] = {place[0][l], place[1][l], place[2][l]};
            if (!(area > 0)) continue;
            for (int o = 0; o < surface.obstacles; ++o) {
                double normal[3];
                const double depth = -gap_of(obstacles[o], at, normal), e = surface.smoothing;
                if (!(depth > 0)) continue;
                const bool soft = depth < e;
                const double push = surface.stiffness * area * (soft ? depth * depth / (2 * e) : depth - e / 2);
                energy += surface.stiffness * area * (soft ? depth * depth * depth / (6 * e)
                                                           : depth * depth / 2 - depth * e / 2 + e * e / 6);
                for (int i = 0; i < 3; ++i) force[i][l] -= push * normal[i];
                touched = true;
            }
        }
        if (!touched) continue;
        Lanes* part = found.parts();
        for (int a = 0; a < surface.functions; ++a, part += 3)
            for (int i = 0; i < 3; ++i) part[i] += force[i] * values[a];
    }
    found.store(forces);
    return energy;
}

// √(w f'') u_i to u [samples][3][functions], u_i = Σ_j C_ij ∂N/∂X_j, and that of i = 1, 2 times f' / (f'' J) to turned
// [samples][2][functions]. Returns 0 where a sample is nearly flat or some f'' is not positive; nothing is written then.
int32_t pc_cofactor_gradients(const Body* given, const double* y, double* u, double* turned) {
    const Body& body = *given;
    const int functions = body.functions;
    struct Row {
        double c[3][3], turn;
    };
    std::vector<Row> rows(body.samples);
    for (int first = 0; first < body.samples; first += LANES) {
        const Deformation at(body, first, y);
        const Lanes squared = square(at.c);
        for (int l = 0; l < LANES && first + l < body.samples; ++l) {
            const int q = first + l;
            const Term<double> f = term(body, q, at.j[l]);
            if (nearly_flat(at.j[l], squared[l], body.flat) || !(f.curvature > 0)) return 0;
            const double root = std::sqrt(body.weights[q] * f.curvature);
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k) rows[q].c[i][k] = root * at.c[i][k][l];
            rows[q].turn = f.slope / (f.curvature * at.j[l]);
        }
    }
    const double* g = body.gradients;
    for (const Row& row : rows) {
        for (int a = 0; a < functions; ++a) {
            double found[3];
            for (int i = 0; i < 3; ++i)
                found[i] = row.c[i][0] * g[a] + row.c[i][1] * g[functions + a] + row.c[i][2] * g[2 * functions + a];
            for (int i = 0; i < 3; ++i) u[i * functions + a] = found[i];
            for (int i = 1; i < 3; ++i) turned[(i - 1) * functions + a] = row.turn * found[i];
        }
        g += 3 * functions, u += 3 * functions, turned += 2 * functions;
    }
    return 1;
}

// The lower half of a matrix [width][width] from its upper one
void pc_mirror(size_t width, double* matrix) {
    constexpr size_t TILE = 8;  // a row and a column of such a square stay in the first cache
    for (size_t row = 0; row < width; row += TILE)
        for (size_t column = row; column < width; column += TILE)
            for (size_t a = row; a < row + TILE && a < width; ++a)
                for (size_t b = column > a ? column : a + 1; b < column + TILE && b < width; ++b)
                    matrix[b * width + a] = matrix[a * width + b];
}

// Blocks [3][functions][3][functions] of the stiffness in place of their upper half Σ w f'' u_i u_kᵀ, with the constant
// term [functions][functions] and the third one: parts [functions][2][functions] of i = 0, last of i = 1, k = 2.
void pc_assemble(int32_t functions, const double* constant, const double* parts, const double* last, double* blocks) {
    const size_t size = functions, width = 3 * size;
    for (size_t a = 0; a < size; ++a)
        for (size_t b = 0; b < size; ++b) {
            double* at = blocks + a * width + b;
            at[size] += parts[2 * size * a + b] - parts[2 * size * b + a];
            at[2 * size] += parts[2 * size * a + size + b] - parts[2 * size * b + size + a];
            at[size * width + 2 * size] += last[size * a + b] - last[size * b + a];
        }
    for (size_t a = 0; a < size; ++a)
        for (size_t b = a; b < size; ++b)
            for (size_t i = 0; i < 3; ++i) blocks[i * size * (width + 1) + a * width + b] += constant[a * size + b];
    pc_mirror(width, blocks);
}
}
