// Energy, forces and the parts of the stiffness of a reduced body of the laws Ψ = μ/2 (I₁ - 3) + f(J).
//
// The arithmetic is that of volumetric.py in float64. Samples come in blocks of LANES: F, stress and forces of a block
// stay in registers and the first cache, so that the gradients are read from memory once. Rows of F belong to
// components of the displacement, columns to directions.

#include <vector>

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

inline Term term(const Body& body, int q, double j) {
    return volume_term(body.logarithmic, j, body.mu[q], body.lam[q]);
}

// F, C = cof F and J of a block of samples.
struct Deformation {
    const Lanes* gradients;
    Lanes f[3][3], c[3][3], j;

    Deformation(const Body& body, int first, const double* y)
        : gradients(reinterpret_cast<const Lanes*>(body.blocks) + size_t(3) * body.functions * (first / LANES)) {
        Lanes sum[3][3] = {};
        const Lanes* g = gradients;
        for (int a = 0; a < body.functions; ++a, g += 3, y += 3)
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k) sum[i][k] += y[i] * g[k];
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) f[i][k] = sum[i][k];
        cofactor(f, c);
        j = dot(f[0], c[0]);
    }
};

}  // namespace

extern "C" {

int32_t pc_lanes() { return LANES; }

// Elastic energy; its derivative by y [functions][3] goes to forces [functions][3].
double pc_energy_and_forces(const Body* given, const double* y, double* forces) {
    const Body& body = *given;
    std::vector<Line> room(3 * size_t(body.functions));  // forces by lanes
    Lanes* parts = reinterpret_cast<Lanes*>(room.data());
    Lanes energies = {};
    for (int first = 0; first < body.samples; first += LANES) {
        const Deformation at(body, first, y);
        const Lanes squared = square(at.f);
        Lanes linear = {}, slopes = {};  // nothing where the last block has no sample
        for (int l = 0; l < LANES && first + l < body.samples; ++l) {
            const int q = first + l;
            const Term f = term(body, q, at.j[l]);
            linear[l] = body.weights[q] * body.mu[q], slopes[l] = body.weights[q] * f.slope;
            energies[l] += 0.5 * linear[l] * (squared[l] - 3) + body.weights[q] * f.value;
        }
        Lanes stress[3][3];
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) stress[i][k] = linear * at.f[i][k] + slopes * at.c[i][k];
        const Lanes* g = at.gradients;
        Lanes* part = parts;
        for (int a = 0; a < body.functions; ++a, g += 3, part += 3)
            for (int i = 0; i < 3; ++i) part[i] += dot(stress[i], g);
    }
    for (int n = 0; n < 3 * body.functions; ++n) forces[n] = total(parts[n]);
    return total(energies);
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
            const Term f = term(body, q, at.j[l]);
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
    constexpr size_t TILE = 8;  // a row and a column of such a square stay in the first cache
    for (size_t row = 0; row < width; row += TILE)
        for (size_t column = row; column < width; column += TILE)
            for (size_t a = row; a < row + TILE && a < width; ++a)
                for (size_t b = column > a ? column : a + 1; b < column + TILE && b < width; ++b)
                    blocks[b * width + a] = blocks[a * width + b];
}
}
