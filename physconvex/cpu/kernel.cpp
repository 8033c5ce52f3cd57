// Singular values of 3 × 3 matrices by Hestenes' one-sided Jacobi rotations, which keep the digits of the small ones.

#include <cmath>
#include <cstdint>
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

}  // namespace

extern "C" {

// u [count][3][3], s [count][3] from the largest on, vt [count][3][3] with f = u diag(s) vt. Returns 0 where a matrix is
// not finite, or flatter than `flat`, the ratio of its smallest and largest s: what is written then is worth nothing.
int32_t pc_singular_values(int64_t count, const double* f, double flat, double* u, double* s, double* vt) {
    for (int64_t n = 0; n < count; ++n, f += 9, u += 9, s += 3, vt += 9) {
        double a[3][3], v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, length[3];
        for (int i = 0; i < 9; ++i) a[i / 3][i % 3] = f[i];
        orthogonalise(a, v);
        for (int k = 0; k < 3; ++k) length[k] = std::sqrt(a[0][k] * a[0][k] + a[1][k] * a[1][k] + a[2][k] * a[2][k]);
        int order[3] = {0, 1, 2};
        for (auto [i, k] : {std::pair{0, 1}, {1, 2}, {0, 1}})
            if (length[order[i]] < length[order[k]]) std::swap(order[i], order[k]);
        if (!(length[order[2]] > flat * length[order[0]])) return 0;
        for (int k = 0; k < 3; ++k) {
            const int from = order[k];
            s[k] = length[from];
            for (int i = 0; i < 3; ++i) u[3 * i + k] = a[i][from] / length[from], vt[3 * k + i] = v[i][from];
        }
    }
    return 1;
}
}
