// Silhouettes and colours of simulated bodies, one block of threads for each picture.
//   clips: body's first node, its number of nodes, first triangle, number of triangles; one row for each clip.

#define THREADS 256

extern "C" __global__ void nearest(
    const int *clips, const float *views, const float *positions, const int *triangles, Sample *samples,
    int frames, int side)
{
    const int clip = blockIdx.x / frames, frame = blockIdx.x % frames;
    const int *c = clips + 4 * clip;
    const float *view = views + VIEW * blockIdx.x;
    const float *x = positions + 3 * ((long long)c[0] * frames + (long long)frame * c[1]);
    Sample *mine = samples + (long long)blockIdx.x * side * side;
    for (int t = threadIdx.x; t < c[3]; t += THREADS) {
        Screen s;
        if (!on_screen(view, x, triangles + 3 * (c[2] + t), s)) continue;
        const int x0 = max(0, (int)floorf(fminf(fminf(s.a[0], s.b[0]), s.c[0])));
        const int x1 = min(side - 1, (int)ceilf(fmaxf(fmaxf(s.a[0], s.b[0]), s.c[0])));
        const int y0 = max(0, (int)floorf(fminf(fminf(s.a[1], s.b[1]), s.c[1])));
        const int y1 = min(side - 1, (int)ceilf(fmaxf(fmaxf(s.a[1], s.b[1]), s.c[1])));
        for (int row = y0; row <= y1; row++)
            for (int column = x0; column <= x1; column++) {
                float w[3];
                if (!inside(s, column + 0.5f, row + 0.5f, w)) continue;
                const float depth = w[0] * s.a[2] + w[1] * s.b[2] + w[2] * s.c[2];
                atomicMin(mine + row * side + column, ((Sample)__float_as_uint(depth) << 32) | (unsigned)t);
            }
    }
}

extern "C" __global__ void resolve(
    const int *clips, const float *views, const float *looks, const float *positions, const float *rest,
    const int *triangles, const Sample *samples, float *pictures, int frames, int side, int factor)
{
    const int clip = blockIdx.x / frames, frame = blockIdx.x % frames, small = side / factor;
    const int *c = clips + 4 * clip;
    const float *view = views + VIEW * blockIdx.x, *look = looks + LOOK * clip;
    const float *x = positions + 3 * ((long long)c[0] * frames + (long long)frame * c[1]);
    const Sample *mine = samples + (long long)blockIdx.x * side * side;
    float *shown = pictures + 4 * (long long)blockIdx.x * small * small;
    for (int pixel = threadIdx.x; pixel < small * small; pixel += THREADS) {
        float sum[4] = {0, 0, 0, 0};
        for (int s = 0; s < factor * factor; s++) {
            const int row = pixel / small * factor + s / factor, column = pixel % small * factor + s % factor;
            const Sample found = mine[row * side + column];
            float rgb[3] = {look[3], look[4], look[5]};
            if (found != ~(Sample)0) {
                const int *t = triangles + 3 * (c[2] + (int)(found & 0xffffffffu));
                Screen screen;
                float w[3];
                on_screen(view, x, t, screen);
                inside(screen, column + 0.5f, row + 0.5f, w);
                shade(look, x, rest + 3 * c[0], t, w, rgb);
                sum[3] += 1;
            }
            for (int k = 0; k < 3; k++) sum[k] += rgb[k];
        }
        for (int k = 0; k < 4; k++) shown[4 * pixel + k] = sum[k] / (factor * factor);
    }
}
