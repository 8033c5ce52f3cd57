// Whole roll-outs of falling bodies, one block of threads each: Runge–Kutta–Chebyshev steps of second order
// (Sommeijer, Shampine, Verwer 1997, RKC, eqs. 2.1–2.4), whose many stages follow stiff viscosity.

#define THREADS 256
#define LARGEST 2048

extern "C" __global__ void __launch_bounds__(THREADS, 2) roll_out(
    const int *table, const float *materials, const float *coefficients, const float *geometry, const short *corners,
    const int *incident, const int *begin, const float *nodes, float *start, float *work, float *forces, float *out,
    int frames)
{
    __shared__ float state[6 * LARGEST];
    const int *t = table + 9 * blockIdx.x;
    const int node0 = t[0], count = t[1], element0 = t[2], elements = t[3], frame0 = t[4], stages = t[5], steps = t[8];
    const float *c = coefficients + 4 * t[6], *p = materials + 10 * blockIdx.x;
    const Material m = {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9]};
    const int *slots = incident + t[7], *starts = begin + node0 + blockIdx.x;
    float *y0 = start + 6 * (long long)node0, *w = work + 18 * (long long)node0;
    float *force = forces + 30 * (long long)element0;
    const int lane = threadIdx.x % POINTS, group = threadIdx.x / POINTS;
    for (int i = threadIdx.x; i < 6 * count; i += THREADS) state[i] = y0[i];
    __syncthreads();
    for (int frame = frame0; frame < frames; frame++) {
        float *shown = out + 3 * ((long long)node0 * frames + (long long)frame * count);
        for (int i = threadIdx.x; i < 3 * count; i += THREADS) shown[i] = state[6 * (i / 3) + i % 3];
        if (frame + 1 == frames) break;
        for (int step = 0; step < steps; step++)
            for (int stage = 1; stage <= stages; stage++) {
                // groups of four threads share an element; all of a warp go through the loop together
                for (int base = 0; base < elements; base += THREADS / POINTS) {
                    const int e = base + group, some = min(e, elements - 1);
                    const float *g = geometry + 10 * (element0 + some);
                    float f[NODES][3];
                    point_forces(state, corners + 10 * (element0 + some), g, lane, m, f);
                    for (int a = 0; a < NODES; a++)
                        for (int k = 0; k < 3; k++) {
                            f[a][k] += __shfl_xor_sync(0xffffffffu, f[a][k], 1);
                            f[a][k] += __shfl_xor_sync(0xffffffffu, f[a][k], 2);
                        }
                    if (e < elements) {
                        float *mine = force + 30 * e;
                        #pragma unroll
                        for (int a = 0; a < NODES; a++)
                            if (a % POINTS == lane)
                                for (int k = 0; k < 3; k++) mine[3 * a + k] = f[a][k];
                    }
                }
                __syncthreads();
                const float mu = c[4 * stage], nu = c[4 * stage + 1], h = m.step;
                const float now = c[4 * stage + 2] * h, first = c[4 * stage + 3] * h;
                for (int i = threadIdx.x; i < count; i += THREADS) {
                    float sum[3] = {0, 0, 0}, rate[6];
                    for (int s = starts[i]; s < starts[i + 1]; s++) {
                        const float *one = force + 3 * slots[s];
                        sum[0] += one[0], sum[1] += one[1], sum[2] += one[2];
                    }
                    const float *body = nodes + 2 * (node0 + i);
                    float *s = state + 6 * i;
                    for (int k = 0; k < 3; k++) rate[k] = s[3 + k];
                    node_acceleration(s, sum, body[0], body[1], m, rate + 3);
                    for (int k = 0; k < 6; k++) { // increments over the step's start, so that rounding stays small
                        float *one = w + k * count + i, *two = w + (6 + k) * count + i, *zero = w + (12 + k) * count + i;
                        const float before = stage == 1 ? 0 : *one, older = stage <= 2 ? 0 : *two;
                        if (stage == 1) *zero = rate[k];
                        const float moved = mu * before + nu * older + now * rate[k] + first * *zero;
                        *two = before, *one = moved;
                        const float total = y0[6 * i + k] + moved;
                        s[k] = total;
                        if (stage == stages) y0[6 * i + k] = total;
                    }
                }
                __syncthreads();
            }
    }
}
