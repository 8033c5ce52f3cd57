// Energy, forces and stiffness of tetrahedra of the laws Ψ = μ/2 (I₁ - 3) + f(J), and Kelvin-Voigt viscosity.
//
// With C = cof F and u_ai = Σ_j C_ij ∂N_a/∂X_j, the stiffness of an element is
//   H_aibk = δ_ik Σ w μ ∂N_a·∂N_b + Σ w f'' u_ai u_bk + Σ w f'/J (u_ai u_bk − u_ak u_bi)
// (see reduced/volumetric.py), and with v_ai = Σ_j F*_ij ∂N_a/∂X_j that of the viscosity of a step
//   Σ w λ_v v_ai v_bk + Σ w μ_v v_ak v_bi + Σ w μ_v (F* F*ᵀ)_ik ∂N_a·∂N_b.
// All in float64, as fem/body.py. LANES elements go at once, one in each lane; what belongs to an element stays in the
// first cache. In the last block lanes that are left over repeat the last element and count nothing.

#include "contact.h"
#include "volumetric.h"

namespace {

constexpr int MOST = 10, POINTS = 4;  // at most so many nodes and quadrature points of an element

struct Elements {
    int32_t count, points, nodes, logarithmic;  // law: 0 neo_hookean, 1 neo_hookean_log
    double flat;                       // |J| over |C|^(3/2) below which a division by J costs digits
    const int32_t* tets;               // [count / LANES, rounded up][nodes][LANES]
    const double* gradients;           // [blocks][points][nodes][3][LANES]: ∂N_a/∂X_j
    const double *weights, *mu, *lam;  // [blocks][points][LANES]
};

struct Block {
    const Elements& body;
    int first, used;
    const int32_t* tets;

    Block(const Elements& body, int first)
        : body(body), first(first), used(body.count - first < LANES ? body.count - first : LANES),
          tets(body.tets + size_t(first) * body.nodes) {}

    const Lanes* gradients(int q) const {
        return reinterpret_cast<const Lanes*>(body.gradients) + size_t(3) * body.nodes * point(q);
    }
    size_t point(int q) const { return size_t(first / LANES) * body.points + q; }
    Lanes at(const double* values, int q) const { return reinterpret_cast<const Lanes*>(values)[point(q)]; }

    void gather(const double* nodal, Lanes (&out)[MOST][3]) const {
        for (int a = 0; a < body.nodes; ++a)
            for (int l = 0; l < LANES; ++l) {
                const double* from = nodal + 3 * size_t(tets[a * LANES + l]);
                for (int i = 0; i < 3; ++i) out[a][i][l] = from[i];
            }
    }

    // ∂x/∂X at a point
    void derivative(const Lanes (&x)[MOST][3], int q, Lanes (&f)[3][3]) const {
        Lanes sum[3][3] = {};
        const Lanes* g = gradients(q);
        for (int a = 0; a < body.nodes; ++a, g += 3)
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k) sum[i][k] += x[a][i] * g[k];
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) f[i][k] = sum[i][k];
    }

    // Matrices [count][points][3][3] of the elements at a point
    void matrices(const double* values, int q, Lanes (&out)[3][3]) const {
        for (int l = 0; l < LANES; ++l) {
            const int element = first + (l < used ? l : used - 1);
            const double* from = values + 9 * (size_t(element) * body.points + q);
            for (int n = 0; n < 9; ++n) out[n / 3][n % 3][l] = from[n];
        }
    }
};

// u_ai = Σ_j A_ij ∂N_a/∂X_j of a matrix A at a point, for sums of r u_ai u_bk + s u_ak u_bi.
struct Fields {
    Lanes u[MOST][3], straight[MOST][3], crossed[MOST][3];

    void set(int nodes, const Lanes (&matrix)[3][3], const Lanes* g, Lanes r, Lanes s) {
        for (int a = 0; a < nodes; ++a)
            for (int i = 0; i < 3; ++i) {
                u[a][i] = dot(matrix[i], g + 3 * a);
                straight[a][i] = r * u[a][i], crossed[a][i] = s * u[a][i];
            }
    }
    void add(int a, int b, Lanes (&sum)[3][3]) const {
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) sum[i][k] += straight[a][i] * u[b][k] + crossed[a][k] * u[b][i];
    }
};

}  // namespace

extern "C" {

int32_t pc_lanes() { return LANES; }

// Elastic energy, and with viscosity (state not null) step/2 times its dissipation; the derivative by x is added to
// forces [nodes of the mesh][3]. x, velocity: of the nodes; the latter may be null without viscosity.
double pc_energy_and_forces(const Elements* given, const double* x, const double* velocity, const double* state,
                            double damping_time, double step, double* forces) {
    const Elements& body = *given;
    Lanes energies = {};
    for (int first = 0; first < body.count; first += LANES) {
        const Block block(body, first);
        Lanes positions[MOST][3], rates[MOST][3], pull[MOST][3] = {};
        block.gather(x, positions);
        if (state) block.gather(velocity, rates);
        for (int q = 0; q < body.points; ++q) {
            const Lanes weight = block.at(body.weights, q), mu = block.at(body.mu, q), lam = block.at(body.lam, q);
            Lanes f[3][3], c[3][3], value = {}, slope = {};
            block.derivative(positions, q, f);
            cofactor(f, c);
            const Lanes j = dot(f[0], c[0]);
            for (int l = 0; l < LANES; ++l) {
                const Term<double> term = volume_term(body.logarithmic, j[l], mu[l], lam[l]);
                value[l] = term.value, slope[l] = term.slope;
            }
            Lanes energy = weight * (0.5 * mu * (square(f) - 3) + value), stress[3][3];
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k) stress[i][k] = weight * (mu * f[i][k] + slope * c[i][k]);
            if (state) {
                Lanes frozen[3][3], rate[3][3], strain[3][3], inner[3][3];
                block.matrices(state, q, frozen);
                block.derivative(rates, q, rate);
                for (int j = 0; j < 3; ++j)
                    for (int k = j; k < 3; ++k) {
                        Lanes sum = {};
                        for (int i = 0; i < 3; ++i) sum += frozen[i][j] * rate[i][k] + frozen[i][k] * rate[i][j];
                        strain[j][k] = strain[k][j] = 0.5 * sum;
                    }
                const Lanes trace = damping_time * weight * lam * (strain[0][0] + strain[1][1] + strain[2][2]);
                for (int j = 0; j < 3; ++j)
                    for (int k = 0; k < 3; ++k) {
                        inner[j][k] = 2 * damping_time * weight * mu * strain[j][k];
                        if (j == k) inner[j][k] += trace;
                        energy += 0.5 * step * inner[j][k] * strain[j][k];
                    }
                for (int i = 0; i < 3; ++i)
                    for (int k = 0; k < 3; ++k)
                        for (int j = 0; j < 3; ++j) stress[i][k] += frozen[i][j] * inner[j][k];
            }
            for (int l = 0; l < block.used; ++l) energies[l] += energy[l];
            const Lanes* g = block.gradients(q);
            for (int a = 0; a < body.nodes; ++a, g += 3)
                for (int i = 0; i < 3; ++i) pull[a][i] += dot(stress[i], g);
        }
        for (int a = 0; a < body.nodes; ++a)
            for (int l = 0; l < block.used; ++l) {
                double* to = forces + 3 * size_t(block.tets[a * LANES + l]);
                for (int i = 0; i < 3; ++i) to[i] += pull[a][i][l];
            }
    }
    return total(energies);
}

// Matrices of the elements [count][nodes][3][nodes][3]; of viscosity, where F* is not null, damping_ratio times that of
// the rate. Returns 0 where the body is nearly flat at a point; what is written then is worth nothing.
int32_t pc_stiffness(const Elements* given, const double* x, const double* state, double damping_ratio, double* out) {
    const Elements& body = *given;
    const int nodes = body.nodes, width = 3 * nodes;
    for (int first = 0; first < body.count; first += LANES) {
        const Block block(body, first);
        Lanes positions[MOST][3];
        block.gather(x, positions);
        Fields elastic[POINTS], viscous[POINTS];
        Lanes linear[POINTS], metric[POINTS][3][3];
        for (int q = 0; q < body.points; ++q) {
            const Lanes weight = block.at(body.weights, q), mu = block.at(body.mu, q), lam = block.at(body.lam, q);
            Lanes f[3][3], c[3][3], own = {}, other = {};
            block.derivative(positions, q, f);
            cofactor(f, c);
            const Lanes j = dot(f[0], c[0]), squared = square(c);
            for (int l = 0; l < LANES; ++l) {
                if (nearly_flat(j[l], squared[l], body.flat)) return 0;
                const Term<double> term = volume_term(body.logarithmic, j[l], mu[l], lam[l]);
                own[l] = weight[l] * term.curvature, other[l] = weight[l] * term.slope / j[l];
            }
            linear[q] = weight * mu;
            elastic[q].set(nodes, c, block.gradients(q), own + other, -other);
            if (!state) continue;
            block.matrices(state, q, f);
            viscous[q].set(nodes, f, block.gradients(q), damping_ratio * weight * lam, damping_ratio * weight * mu);
            for (int i = 0; i < 3; ++i)
                for (int k = 0; k < 3; ++k) metric[q][i][k] = damping_ratio * weight * mu * dot(f[i], f[k]);
        }
        for (int a = 0; a < nodes; ++a)
            for (int b = a; b < nodes; ++b) {
                Lanes sum[3][3] = {};
                for (int q = 0; q < body.points; ++q) {
                    const Lanes* g = block.gradients(q);
                    const Lanes common = dot(g + 3 * a, g + 3 * b);
                    elastic[q].add(a, b, sum);
                    for (int i = 0; i < 3; ++i) sum[i][i] += linear[q] * common;
                    if (!state) continue;
                    viscous[q].add(a, b, sum);
                    for (int i = 0; i < 3; ++i)
                        for (int k = 0; k < 3; ++k) sum[i][k] += metric[q][i][k] * common;
                }
                for (int l = 0; l < block.used; ++l) {
                    double* matrix = out + size_t(first + l) * width * width;
                    for (int i = 0; i < 3; ++i)
                        for (int k = 0; k < 3; ++k) {
                            matrix[(3 * a + i) * width + 3 * b + k] = sum[i][k][l];
                            matrix[(3 * b + k) * width + 3 * a + i] = sum[i][k][l];
                        }
                }
            }
    }
    return 1;
}

// Adds local[entries[n]] to values[slots[n]].
void pc_assemble(int64_t count, const int32_t* entries, const int32_t* slots, const double* local, double* values) {
    for (int64_t n = 0; n < count; ++n) values[slots[n]] += local[entries[n]];
}
}
