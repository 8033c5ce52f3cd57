// Forces on the nodes of one falling body: elastic and viscous in its quadratic tetrahedra, weight, floor and friction.
// The includer defines DEVICE and includes neo_hookean.h.

#define NODES 10
#define POINTS 4

struct Material {
    float mu, lambda, damping_time, contact_stiffness, smoothing, friction, slip_velocity, step, gravity, stiffest;
};

// Barycentric coordinates of the four-point rule, and which corners a mid-edge node lies between.
#define NEAR 0.5854101966249685f
#define FAR 0.1381966011250105f

// Forces of one quadrature point of an element on its ten nodes.
//   state: x and v of the nodes, [n, 6]; corner gradients g of the barycentric coordinates 1..3, [3, 3], and the volume.
DEVICE void point_forces(
    const float *state, const short *nodes, const float *g, int point, const Material &m, float out[NODES][3])
{
    const int first[6] = {0, 1, 0, 0, 1, 2}, second[6] = {1, 2, 2, 3, 3, 3};
    float b[4], f[9] = {0}, rate[9] = {0};
    for (int i = 0; i < 4; i++) b[i] = i == point ? NEAR : FAR;
    float dx[4][3], dv[4][3]; // derivatives of x and v by the barycentric coordinates
    for (int i = 0; i < 4; i++) {
        const float *s = state + 6 * nodes[i];
        const float w = 4 * b[i] - 1;
        for (int k = 0; k < 3; k++) dx[i][k] = w * s[k], dv[i][k] = w * s[3 + k];
    }
    for (int e = 0; e < 6; e++) {
        const float *s = state + 6 * nodes[4 + e];
        const int i = first[e], j = second[e];
        for (int k = 0; k < 3; k++) {
            dx[i][k] += 4 * b[j] * s[k], dx[j][k] += 4 * b[i] * s[k];
            dv[i][k] += 4 * b[j] * s[3 + k], dv[j][k] += 4 * b[i] * s[3 + k];
        }
    }
    for (int i = 1; i < 4; i++)
        for (int k = 0; k < 3; k++) {
            const float x = dx[i][k] - dx[0][k], v = dv[i][k] - dv[0][k];
            for (int l = 0; l < 3; l++) f[3 * k + l] += x * g[3 * i - 3 + l], rate[3 * k + l] += v * g[3 * i - 3 + l];
        }
    const float c[9] = {f[4] * f[8] - f[5] * f[7], f[5] * f[6] - f[3] * f[8], f[3] * f[7] - f[4] * f[6],
                        f[7] * f[2] - f[8] * f[1], f[8] * f[0] - f[6] * f[2], f[6] * f[1] - f[7] * f[0],
                        f[1] * f[5] - f[2] * f[4], f[2] * f[3] - f[0] * f[5], f[0] * f[4] - f[1] * f[3]};
    const float j = f[0] * c[0] + f[1] * c[1] + f[2] * c[2];
    const float pressure = neo_hookean_term(j, m.mu, m.lambda).slope;
    float strain[9]; // Fᵀ Ḟ
    for (int k = 0; k < 3; k++)
        for (int l = 0; l < 3; l++)
            strain[3 * k + l] = f[k] * rate[l] + f[3 + k] * rate[3 + l] + f[6 + k] * rate[6 + l];
    const float shear = m.damping_time * m.mu, volume = m.damping_time * m.lambda * (strain[0] + strain[4] + strain[8]);
    float inner[9];
    for (int k = 0; k < 3; k++)
        for (int l = 0; l < 3; l++) inner[3 * k + l] = shear * (strain[3 * k + l] + strain[3 * l + k]);
    inner[0] += volume, inner[4] += volume, inner[8] += volume;
    float stress[9];
    for (int k = 0; k < 3; k++)
        for (int l = 0; l < 3; l++)
            stress[3 * k + l] = m.mu * f[3 * k + l] + pressure * c[3 * k + l] + f[3 * k] * inner[l] +
                                f[3 * k + 1] * inner[3 + l] + f[3 * k + 2] * inner[6 + l];
    float pull[4][3]; // minus the derivative of the point's energy by dx
    const float weight = -g[9] / POINTS;
    for (int k = 0; k < 3; k++) {
        pull[0][k] = 0;
        for (int i = 1; i < 4; i++) {
            const float *d = g + 3 * i - 3;
            pull[i][k] = weight * (stress[3 * k] * d[0] + stress[3 * k + 1] * d[1] + stress[3 * k + 2] * d[2]);
            pull[0][k] -= pull[i][k];
        }
    }
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < 3; k++) out[i][k] = (4 * b[i] - 1) * pull[i][k];
    for (int e = 0; e < 6; e++)
        for (int k = 0; k < 3; k++) out[4 + e][k] = 4 * (b[second[e]] * pull[first[e]][k] + b[first[e]] * pull[second[e]][k]);
}

// Acceleration of a node with the elastic force given: weight, floor z = 0 (a C² hinge), smoothed Coulomb friction.
DEVICE void node_acceleration(const float *state, const float *force, float mass, float area, const Material &m, float *a)
{
    const float inverse = 1 / mass, depth = -state[2];
    for (int k = 0; k < 3; k++) a[k] = force[k] * inverse;
    a[2] += m.gravity;
    if (area <= 0 || depth <= 0) return;
    const float e = m.smoothing, slope = depth < e ? depth * depth / (2 * e) : depth - e / 2;
    const float push = area * m.contact_stiffness * slope * inverse, limit = m.friction * push;
    a[2] += push;
    const float slip = fmaxf(m.slip_velocity, 2 * limit / m.stiffest); // no faster than the stages follow
    const float x = state[3], y = state[4], relative = sqrtf(x * x + y * y) / slip;
    const float drag = limit * (relative < 1 ? 2 - relative : 1 / relative) / slip;
    a[0] -= drag * x, a[1] -= drag * y;
}
