// The laws Ψ = μ/2 (I₁ - 3) + f(J) of materials/volumetric.py, and what acts on LANES points at once, in float64.
//
// Rows of F belong to components of the positions, columns to directions.

#pragma once

#include <cmath>
#include <cstdint>
#include <limits>

#define DEVICE inline
#include "neo_hookean.h"

#if defined(__AVX512F__)
constexpr int LANES = 8;
#elif defined(__AVX__)
constexpr int LANES = 4;
#else
constexpr int LANES = 2;
#endif
typedef double Lanes __attribute__((vector_size(sizeof(double) * LANES), aligned(8), may_alias));

inline Term<double> volume_term(bool logarithmic, double j, double mu, double lam) {
    if (!logarithmic) return neo_hookean_term(j, mu, lam);
    const bool proper = j > 0;
    const double safe = proper ? j : 1.0, log = std::log(safe);
    const double value = proper ? (0.5 * lam * log - mu) * log : std::numeric_limits<double>::infinity();
    return {value, (lam * log - mu) / safe, (lam + mu - lam * log) / (safe * safe)};
}

inline Lanes dot(const Lanes* a, const Lanes* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

inline Lanes square(const Lanes (&a)[3][3]) { return dot(a[0], a[0]) + dot(a[1], a[1]) + dot(a[2], a[2]); }

inline double total(const Lanes& lanes) {
    double sum = 0;
    for (int l = 0; l < LANES; ++l) sum += lanes[l];
    return sum;
}

// Row i is the cross product of the other two rows of F.
inline void cofactor(const Lanes (&f)[3][3], Lanes (&c)[3][3]) {
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) {
            const int a = (i + 1) % 3, b = (i + 2) % 3, m = (k + 1) % 3, n = (k + 2) % 3;
            c[i][k] = f[a][m] * f[b][n] - f[a][n] * f[b][m];
        }
}

// Whether a body is squeezed flat at a point, so that what is divided by J loses its digits; square: that of cof F.
inline bool nearly_flat(double j, double square, double limit) {
    return !(j * j >= limit * limit * square * std::sqrt(square));
}
