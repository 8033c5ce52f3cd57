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
    for (int t = threadIdx.x; t < c[3]; t += THREADS)
        cover(view, x, triangles + 3 * (c[2] + t), t, side, [=](int place, Sample found) {
            atomicMin(mine + place, found);
        });
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
    for (int pixel = threadIdx.x; pixel < small * small; pixel += THREADS)
        resolve_pixel(
            view, look, x, rest + 3 * c[0], triangles + 3 * c[2], mine, side, factor, pixel, shown + 4 * pixel);
}
