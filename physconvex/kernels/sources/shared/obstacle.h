// What bodies touch: planes and spheres.

#pragma once

#include <algorithm>
#include <cmath>

struct Obstacle {
    double sphere;      // 0: a plane
    double vector[3];   // normal, or centre
    double size;        // distance of the plane from the origin, or radius
    double velocity[3];
    double friction;
};

// Signed distance of a place, and its gradient
inline double gap_of(const Obstacle& o, const double* place, double (&normal)[3]) {
    if (o.sphere == 0) {
        for (int i = 0; i < 3; ++i) normal[i] = o.vector[i];
        return place[0] * normal[0] + place[1] * normal[1] + place[2] * normal[2] - o.size;
    }
    double off[3], distance = 0;
    for (int i = 0; i < 3; ++i) off[i] = place[i] - o.vector[i], distance += off[i] * off[i];
    distance = std::max(std::sqrt(distance), 1e-12);
    for (int i = 0; i < 3; ++i) normal[i] = off[i] / distance;
    return distance - o.size;
}
