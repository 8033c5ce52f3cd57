// Functions of the singular values of 3 × 3 matrices, found by Hestenes' one-sided Jacobi rotations, which keep the
// digits of the small ones.

#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

namespace {

constexpr int SWEEPS = 12;            // more than ever needed; five are usual
constexpr double STRAIGHT = 1e-15;    // cosine between two columns below which they count as orthogonal

// Turns columns of a by rotations, gathered in v, until they are orthogonal: a v = u diag(s)
void orthogonalise(double (&a)[3][3], double (&v)[3][3]) {
    for (int sweep = 0; sweep < SWEEPS; ++sweep) {
        bool turned = false;
        for (int p = 0; p < 2; ++p)
            for (int q = p + 1; q < 3; ++q) {
                double pp = 0, qq = 0, pq = 0;
                for (int i = 0; i < 3; ++i) pp += a[i][p] * a[i][p], qq += a[i][q] * a[i][q], pq += a[i][p] * a[i][q];
                if (std::abs(pq) <= STRAIGHT * std::sqrt(pp * qq)) continue;
                turned = true;
                const double zeta = (qq - pp) / (2 * pq);
                const double t = std::copysign(1 / (std::abs(zeta) + std::sqrt(1 + zeta * zeta)), zeta);
                const double c = 1 / std::sqrt(1 + t * t), s = c * t;
                for (int i = 0; i < 3; ++i) {
                    const double x = a[i][p], y = v[i][p];
                    a[i][p] = c * x - s * a[i][q], a[i][q] = s * x + c * a[i][q];
                    v[i][p] = c * y - s * v[i][q], v[i][q] = s * y + c * v[i][q];
                }
            }
        if (!turned) return;
    }
}

// F = u diag(s) vt, s from the largest on. False where F is not finite, or flatter than `flat`, the ratio of its smallest
// and largest s: what is written then is worth nothing.
bool decompose(const double* f, double flat, double* u, double* s, double* vt) {
    double a[3][3], v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, length[3];
    for (int i = 0; i < 9; ++i) a[i / 3][i % 3] = f[i];
    orthogonalise(a, v);
    for (int k = 0; k < 3; ++k) length[k] = std::sqrt(a[0][k] * a[0][k] + a[1][k] * a[1][k] + a[2][k] * a[2][k]);
    int order[3] = {0, 1, 2};
    for (auto [i, k] : {std::pair{0, 1}, {1, 2}, {0, 1}})
        if (length[order[i]] < length[order[k]]) std::swap(order[i], order[k]);
    if (!(length[order[2]] > flat * length[order[0]])) return false;
    for (int k = 0; k < 3; ++k) {
        const int from = order[k];
        s[k] = length[from];
        for (int i = 0; i < 3; ++i) u[3 * i + k] = a[i][from] / length[from], vt[3 * k + i] = v[i][from];
    }
    return true;
}

// c = a b, or a bᵀ
void multiply(const double* a, const double* b, bool turned, double* c) {
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) {
            c[3 * i + k] = 0;
            for (int j = 0; j < 3; ++j) c[3 * i + k] += a[3 * i + j] * (turned ? b[3 * k + j] : b[3 * j + k]);
        }
}

double determinant(const double* f) {
    return f[0] * (f[4] * f[8] - f[5] * f[7]) + f[1] * (f[5] * f[6] - f[3] * f[8]) + f[2] * (f[3] * f[7] - f[4] * f[6]);
}

}  // namespace

extern "C" {

// u [count][3][3], s [count][3] and vt [count][3][3] of f [count][3][3], see `decompose`; 0 where one cannot be had.
int32_t pc_singular_values(int64_t count, const double* f, double flat, double* u, double* s, double* vt) {
    for (int64_t n = 0; n < count; ++n)
        if (!decompose(f + 9 * n, flat, u + 9 * n, s + 3 * n, vt + 9 * n)) return 0;
    return 1;
}

// Energy density [count] and first Piola-Kirchhoff stress [count][3][3] of what flows, as LogarithmicStep of inelastic.py: f and
// undo [count][3][3]; mu, bulk and limit [count]. 0 where F F_f⁻¹ has no principal frame, see `decompose`.
int32_t pc_flow_response(int64_t count, const double* f, const double* undo, const double* mu, const double* bulk,
                         const double* limit, double left, int32_t tension, double flat, double* energy,
                         double* stress) {
    for (int64_t n = 0; n < count; ++n, f += 9, undo += 9, stress += 9) {
        double elastic[9], u[9], s[3], vt[9], strain[3], trace = 0, radius = 0;
        multiply(f, undo, false, elastic);
        if (!decompose(elastic, flat, u, s, vt)) return 0;
        for (int k = 0; k < 3; ++k) strain[k] = std::log(s[k]), trace += strain[k];
        for (int k = 0; k < 3; ++k) strain[k] -= trace / 3, radius += strain[k] * strain[k];  // the deviator
        radius = std::sqrt(radius);
        const double m = left * mu[n], most = !tension && trace > 0 ? 0.0 : limit[n];
        const double pressing = tension ? trace : std::fmin(trace, 0.0);
        const bool yields = 2 * m * radius >= most;
        const double shear = yields ? most * radius - most * most / (4 * m) : m * radius * radius;
        energy[n] = determinant(elastic) > 0 ? shear + bulk[n] / 2 * pressing * pressing
                                             : std::numeric_limits<double>::infinity();
        const double secant = yields ? most / std::fmax(radius, 1e-100) : 2 * m;
        double turned[9], pulled[9];
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k)
                turned[3 * i + k] = u[3 * i + k] * (secant * strain[k] + bulk[n] * pressing) / s[k];
        multiply(turned, vt, false, pulled);
        multiply(pulled, undo, true, stress);
    }
    return 1;
}
}
