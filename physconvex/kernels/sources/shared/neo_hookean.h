// f, f' and f'' of the law Ψ = μ/2 (I₁ - 3) + f(J) that the name neo_hookean means, for C++ and CUDA in any precision.
// The includer defines DEVICE.

#ifndef NEO_HOOKEAN_H
#define NEO_HOOKEAN_H

template <typename Real>
struct Term {  // f, f' and f'' at a point
    Real value, slope, curvature;
};

template <typename Real>
DEVICE Term<Real> neo_hookean_term(Real j, Real mu, Real lam) {
    const Real d = j - 1, slope = (lam + mu) * d - mu;
    return {Real(0.5) * d * (slope - mu), slope, lam + mu};
}

#endif
