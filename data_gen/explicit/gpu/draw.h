// Pictures of a surface of triangles: nearest triangle at every sample, then colour and coverage of every pixel.
// The includer defines DEVICE and bits_of(float). A view is 16 numbers: rows of the rotation, eye, focal length, centre x, y, samples per pixel.

#define VIEW 16
#define LOOK 40 // colour of the body (3), of the background (3), light (3), ambient, four waves of 3 + 1 + 3, 2 unused
#define WAVES 4

typedef unsigned long long Sample; // depth in the upper half, triangle in the lower

DEVICE void project(const float *view, const float *x, float *p)
{
    const float d[3] = {x[0] - view[9], x[1] - view[10], x[2] - view[11]};
    const float depth = view[6] * d[0] + view[7] * d[1] + view[8] * d[2];
    const float f = view[12] * view[15] / depth;
    p[0] = f * (view[0] * d[0] + view[1] * d[1] + view[2] * d[2]) + view[13] * view[15];
    p[1] = f * (view[3] * d[0] + view[4] * d[1] + view[5] * d[2]) + view[14] * view[15];
    p[2] = depth;
}

// Barycentric coordinates of a point of the picture; false where the triangle shows its back.
struct Screen {
    float a[3], b[3], c[3], area;
};

DEVICE bool on_screen(const float *view, const float *positions, const int *triangle, Screen &s)
{
    project(view, positions + 3 * triangle[0], s.a);
    project(view, positions + 3 * triangle[1], s.b);
    project(view, positions + 3 * triangle[2], s.c);
    s.area = (s.b[0] - s.a[0]) * (s.c[1] - s.a[1]) - (s.b[1] - s.a[1]) * (s.c[0] - s.a[0]);
    return s.area < 0 && s.a[2] > 0 && s.b[2] > 0 && s.c[2] > 0; // rows run downwards
}

// First and last column and row of the samples that a triangle may cover.
DEVICE void box_of(const Screen &s, int side, int *box)
{
    for (int k = 0; k < 2; k++) {
        const int low = (int)floorf(fminf(fminf(s.a[k], s.b[k]), s.c[k]));
        const int high = (int)ceilf(fmaxf(fmaxf(s.a[k], s.b[k]), s.c[k]));
        box[2 * k] = low > 0 ? low : 0, box[2 * k + 1] = high < side - 1 ? high : side - 1;
    }
}

DEVICE bool inside(const Screen &s, float x, float y, float *w)
{
    w[1] = ((x - s.a[0]) * (s.c[1] - s.a[1]) - (y - s.a[1]) * (s.c[0] - s.a[0])) / s.area;
    w[2] = ((s.b[0] - s.a[0]) * (y - s.a[1]) - (s.b[1] - s.a[1]) * (x - s.a[0])) / s.area;
    w[0] = 1 - w[1] - w[2];
    return w[0] >= 0 && w[1] >= 0 && w[2] >= 0;
}

// Calls keep(place among the samples, sample) for all samples of a picture that a triangle covers.
template <typename Keep>
DEVICE void cover(const float *view, const float *positions, const int *triangle, int number, int side, Keep keep)
{
    Screen s;
    if (!on_screen(view, positions, triangle, s)) return;
    int box[4];
    box_of(s, side, box);
    for (int row = box[2]; row <= box[3]; row++)
        for (int column = box[0]; column <= box[1]; column++) {
            float w[3];
            if (!inside(s, column + 0.5f, row + 0.5f, w)) continue;
            const float depth = w[0] * s.a[2] + w[1] * s.b[2] + w[2] * s.c[2];
            keep(row * side + column, ((Sample)bits_of(depth) << 32) | (unsigned)number);
        }
}

// Colour (0..255) of a triangle at a point: waves of the rest position, lit.
DEVICE void shade(const float *look, const float *positions, const float *rest, const int *t, const float *w, float *rgb)
{
    float x[3], u[3], v[3];
    for (int k = 0; k < 3; k++) {
        x[k] = w[0] * rest[3 * t[0] + k] + w[1] * rest[3 * t[1] + k] + w[2] * rest[3 * t[2] + k];
        u[k] = positions[3 * t[1] + k] - positions[3 * t[0] + k];
        v[k] = positions[3 * t[2] + k] - positions[3 * t[0] + k];
    }
    const float n[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    const float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) + 1e-20f;
    const float facing = (n[0] * look[6] + n[1] * look[7] + n[2] * look[8]) / length;
    const float light = look[9] + (facing > 0 ? facing : 0);
    for (int k = 0; k < 3; k++) rgb[k] = look[k];
    for (int i = 0; i < WAVES; i++) {
        const float *wave = look + 10 + 7 * i;
        const float s = sinf(wave[0] * x[0] + wave[1] * x[1] + wave[2] * x[2] + wave[3]);
        for (int k = 0; k < 3; k++) rgb[k] += wave[4 + k] * s;
    }
    for (int k = 0; k < 3; k++) rgb[k] = fminf(fmaxf(rgb[k] * light, 0.0f), 255.0f);
}

// Colour and coverage of a pixel from its samples; triangles are those of the body.
DEVICE void resolve_pixel(
    const float *view, const float *look, const float *positions, const float *rest, const int *triangles,
    const Sample *samples, int side, int factor, int pixel, float *shown)
{
    const int small = side / factor;
    float sum[4] = {0, 0, 0, 0};
    for (int s = 0; s < factor * factor; s++) {
        const int row = pixel / small * factor + s / factor, column = pixel % small * factor + s % factor;
        const Sample found = samples[row * side + column];
        float rgb[3] = {look[3], look[4], look[5]};
        if (found != ~(Sample)0) {
            const int *t = triangles + 3 * (int)(found & 0xffffffffu);
            Screen screen;
            float w[3];
            on_screen(view, positions, t, screen);
            inside(screen, column + 0.5f, row + 0.5f, w);
            shade(look, positions, rest, t, w, rgb);
            sum[3] += 1;
        }
        for (int k = 0; k < 3; k++) sum[k] += rgb[k];
    }
    for (int k = 0; k < 4; k++) shown[k] = sum[k] / (factor * factor);
}
