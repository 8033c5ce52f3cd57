// The limit that the rasteriser is held against: nothing but the blending of soft-edged polygons, front to back, written
// straight down. Rows of 16 pixels, the kernel's exponential and logarithm, exact culling per row and polygon; no tiles,
// no heaviest polygon, no depth, no termination, nothing kept for a backward pass.
#include "arithmetic.h"

// One thread. coordinates [height, width, 2] of a plane grid, lines [polygons, sides, 3], features [polygons, 4] of which
// red, green and blue are blended into image [height, width, 3].
extern "C" void blend_loop(int width, int height, int polygons, int sides, const float* coordinates, const float* lines,
                           const float* sharpness, const float* opacity, const float* features, float* image) {
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; x += LANES) {
            const int lanes = std::min(LANES, width - x);
            float u[LANES], v[LANES], through[LANES], red[LANES], green[LANES], blue[LANES];
            for (int l = 0; l < LANES; ++l) {
                const float* q = coordinates + 2 * (static_cast<size_t>(y) * width + x + std::min(l, lanes - 1));
                u[l] = q[0], v[l] = q[1], through[l] = 1.0f, red[l] = green[l] = blue[l] = 0.0f;
            }
            for (int m = 0; m < polygons; ++m) {
                const float *line = lines + 3 * sides * static_cast<size_t>(m), beta = sharpness[m], strength = opacity[m];
                const float reach = std::log(std::max(255.0f * strength - 1.0f, 1e-30f)) / beta;
                bool seen = true;
                for (int h = 0; h < sides && seen; ++h) {
                    const float *s = line + 3 * h, left = s[0] * u[0], right = s[0] * u[LANES - 1];
                    seen = std::min(left, right) + s[1] * v[0] + s[2] <= reach;
                }
                if (!seen) continue;
                float sum[LANES] = {}, most[LANES];
                for (int l = 0; l < LANES; ++l) most[l] = -1e30f;
                for (int h = 0; h < sides; ++h)
#pragma omp simd
                    for (int l = 0; l < LANES; ++l)
                        most[l] = std::max(most[l], line[3 * h] * u[l] + line[3 * h + 1] * v[l] + line[3 * h + 2]);
                for (int h = 0; h < sides; ++h)
#pragma omp simd
                    for (int l = 0; l < LANES; ++l)
                        sum[l] += exponential(line[3 * h] * u[l] + line[3 * h + 1] * v[l] + line[3 * h + 2] - most[l]);
                const float *f = features + 4 * m;
#pragma omp simd
                for (int l = 0; l < LANES; ++l) {
                    const float phi = most[l] + logarithm(sum[l]);
                    float alpha = std::min(strength / (1.0f + exponential(beta * phi)), 0.99f);
                    alpha = alpha < 1.0f / 255 ? 0.0f : alpha;
                    const float weight = alpha * through[l];
                    red[l] += weight * f[0], green[l] += weight * f[1], blue[l] += weight * f[2], through[l] -= weight;
                }
            }
            for (int l = 0; l < lanes; ++l) {
                float* pixel = image + 3 * (static_cast<size_t>(y) * width + x + l);
                pixel[0] = red[l], pixel[1] = green[l], pixel[2] = blue[l];
            }
        }
}
