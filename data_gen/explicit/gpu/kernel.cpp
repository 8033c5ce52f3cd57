// The same roll-outs on the processor, one after the other; for checks.

#include <algorithm>
#include <cmath>
#include <vector>
#define DEVICE inline
#include "neo_hookean.h"
#include "body.h"

extern "C" void roll_out(
    int bodies, const int *table, const float *materials, const float *coefficients, const float *geometry,
    const short *corners, const int *incident, const int *begin, const float *nodes, float *start, float *out,
    int frames)
{
    for (int number = 0; number < bodies; number++) {
        const int *t = table + 9 * number;
        const int node0 = t[0], count = t[1], element0 = t[2], elements = t[3], frame0 = t[4], stages = t[5], steps = t[8];
        const float *c = coefficients + 4 * t[6], *p = materials + 10 * number;
        const Material m = {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9]};
        float *y0 = start + 6 * (long long)node0;
        std::vector<float> state(y0, y0 + 6 * count), one(6 * count), two(6 * count), zero(6 * count), force(3 * count);
        for (int frame = frame0; frame < frames; frame++) {
            float *shown = out + 3 * ((long long)node0 * frames + (long long)frame * count);
            for (int i = 0; i < 3 * count; i++) shown[i] = state[6 * (i / 3) + i % 3];
            if (frame + 1 == frames) break;
            for (int step = 0; step < steps; step++) {
                std::fill(one.begin(), one.end(), 0.0f), std::fill(two.begin(), two.end(), 0.0f);
                for (int stage = 1; stage <= stages; stage++) {
                    std::fill(force.begin(), force.end(), 0.0f);
                    for (int e = 0; e < elements; e++)
                        for (int q = 0; q < POINTS; q++) {
                            float f[NODES][3];
                            const short *ten = corners + 10 * (element0 + e);
                            point_forces(state.data(), ten, geometry + 10 * (element0 + e), q, m, f);
                            for (int a = 0; a < NODES; a++)
                                for (int k = 0; k < 3; k++) force[3 * ten[a] + k] += f[a][k];
                        }
                    const float mu = c[4 * stage], nu = c[4 * stage + 1], h = m.step;
                    const float now = c[4 * stage + 2] * h, first = c[4 * stage + 3] * h;
                    for (int i = 0; i < count; i++) {
                        float *s = &state[6 * i], rate[6] = {s[3], s[4], s[5]};
                        const float *body = nodes + 2 * (node0 + i);
                        node_acceleration(s, &force[3 * i], body[0], body[1], m, rate + 3);
                        for (int k = 0; k < 6; k++) {
                            const int n = 6 * i + k;
                            if (stage == 1) zero[n] = rate[k];
                            const float moved = mu * one[n] + nu * two[n] + now * rate[k] + first * zero[n];
                            two[n] = one[n], one[n] = moved;
                            s[k] = y0[n] + moved;
                        }
                    }
                }
                std::copy(state.begin(), state.end(), y0);
            }
        }
    }
}

#include <cstring>

inline unsigned bits_of(float value)
{
    unsigned bits;
    std::memcpy(&bits, &value, 4);
    return bits;
}
#include "draw.h"

// Pictures [clips, frames, side / factor, side / factor, 4] as draw.cu makes them.
extern "C" void draw(
    int count, const int *clips, const float *views, const float *looks, const float *positions, const float *rest,
    const int *triangles, float *pictures, int frames, int side, int factor)
{
    const int small = side / factor;
    std::vector<Sample> samples(side * side);
    for (int picture = 0; picture < count * frames; picture++) {
        const int *c = clips + 4 * (picture / frames);
        const float *view = views + VIEW * picture, *look = looks + LOOK * (picture / frames);
        const float *x = positions + 3 * ((long long)c[0] * frames + (long long)(picture % frames) * c[1]);
        std::fill(samples.begin(), samples.end(), ~(Sample)0);
        for (int t = 0; t < c[3]; t++)
            cover(view, x, triangles + 3 * (c[2] + t), t, side, [&](int place, Sample found) {
                samples[place] = std::min(samples[place], found);
            });
        float *shown = pictures + 4 * (long long)picture * small * small;
        for (int pixel = 0; pixel < small * small; pixel++)
            resolve_pixel(
                view, look, x, rest + 3 * c[0], triangles + 3 * c[2], samples.data(), side, factor, pixel,
                shown + 4 * pixel);
    }
}
