// Convex hulls of few points in a plane, as in hull.py: text that the CPU and a GPU compile.
#ifndef DEVICE
#pragma once
#define DEVICE inline
#include <cmath>
#endif

// Gift wrapping. Products are compared, not subtracted, so that fusing them cannot change a sign.
DEVICE void wrap(int points, const double* p, long long* order, long long* number) {
    int start = 0;
    for (int k = 1; k < points; ++k)
        if (p[2 * k + 1] < p[2 * start + 1] || (p[2 * k + 1] == p[2 * start + 1] && p[2 * k] < p[2 * start])) start = k;
    for (int k = 0; k < points; ++k) order[k] = 0;
    *number = 0;
    int current = start;
    do {
        order[(*number)++] = current;
        int best = 0;
        double x = p[0] - p[2 * current], y = p[1] - p[2 * current + 1];
        for (int k = 1; k < points; ++k) {
            const double u = p[2 * k] - p[2 * current], v = p[2 * k + 1] - p[2 * current + 1];
            const double left = x * v, right = y * u;
            if (left < right || (left == right && u * u + v * v > x * x + y * y)) best = k, x = u, y = v;
        }
        current = best;
    } while (*number < points && (p[2 * current] != p[2 * start] || p[2 * current + 1] != p[2 * start + 1]));
}

// The least, over sides, of the greatest distance of a point from that side.
DEVICE double least_width(int points, const double* p, const long long* order, int corners) {
    if (corners < 3) return 0.0;
    double least = 1e300;
    for (int c = 0; c < corners; ++c) {
        const double *a = p + 2 * order[c], *b = p + 2 * order[(c + 1) % corners];
        const double x = b[0] - a[0], y = b[1] - a[1];
        double greatest = 0.0;
        for (int k = 0; k < points; ++k) {
            const double distance = x * (p[2 * k + 1] - a[1]) - y * (p[2 * k] - a[0]);
            if (distance > greatest) greatest = distance;
        }
        greatest /= sqrt(x * x + y * y);
        if (greatest < least) least = greatest;
    }
    return least;
}
