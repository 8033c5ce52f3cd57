// What all parts of the kernel share: sizes, the scene, exp and log, threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <thread>
#include <utility>
#include <vector>

constexpr int SIDE = 16;      // pixels of a tile along each side
constexpr int LANES = SIDE;   // pixels of a row
constexpr int FEATURES = 4;   // red, green, blue, depth
constexpr float LEAST_ALPHA = 1.0f / 255.0f;
constexpr float GREATEST_ALPHA = 0.99f;
constexpr float LEAST_TRANSMITTANCE = 1e-4f;
constexpr float FAR = 1e30f;

using Row = float[LANES];

#define EACH_LANE _Pragma("omp simd") for (int l = 0; l < LANES; ++l)

// What is drawn; the layouts are those of `Splats` and of `View.pixel_coordinates`.
struct Scene {
    int32_t width, height, polygons, threads;
    const float* coordinates;  // [height, width, 2]
    const int32_t* starts;     // [polygons + 1]
    const float* lines;        // [L, 3]
    const float* sharpness;    // [polygons]
    const float* opacity;      // [polygons]
    const float* features;     // [polygons, 4]
};

inline float as_float(int32_t bits) { float x; std::memcpy(&x, &bits, sizeof x); return x; }
inline int32_t as_bits(float x) { int32_t bits; std::memcpy(&bits, &x, sizeof bits); return bits; }

// exp x = 2^n exp r with |r| ≤ log(2)/2, and its Taylor series to r^6: relative error below 2e-7.
inline float exponential(float x) {
    x = std::min(std::max(x, -87.0f), 88.0f);
    const float shifted = x * 1.44269504f + 12582912.0f;  // adding 1.5 · 2^23 leaves n in the lowest bits
    const float n = shifted - 12582912.0f;
    const float r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    float y = 1.0f / 720;
    y = y * r + 1.0f / 120;
    y = y * r + 1.0f / 24;
    y = y * r + 1.0f / 6;
    y = y * r + 0.5f;
    y = y * r + 1.0f;
    y = y * r + 1.0f;
    return y * as_float((as_bits(shifted) << 23) + 0x3f800000);
}

// log x = e log 2 + 2 artanh z, z = (m - 1) / (m + 1), for x = m 2^e with m from √½ to √2.
inline float logarithm(float x) {
    const int32_t bits = as_bits(x) - 0x3f3504f3;
    const int32_t exponent = bits >> 23;
    const float m = as_float((bits & 0x7fffff) + 0x3f3504f3);
    const float z = (m - 1.0f) / (m + 1.0f), q = z * z;
    const float series = 1.0f + q * (1.0f / 3 + q * (1.0f / 5 + q * (1.0f / 7 + q * (1.0f / 9))));
    return static_cast<float>(exponent) * 0.693147181f + 2.0f * z * series;
}

inline float sum(const Row x) {
    float total = 0.0f;
#pragma omp simd reduction(+ : total)
    for (int l = 0; l < LANES; ++l) total += x[l];
    return total;
}

template <class Work>  // work(item, thread)
void in_parallel(int items, int threads, const Work& work) {
    std::atomic<int> next{0};
    auto run = [&](int thread) {
        for (int item = next++; item < items; item = next++) work(item, thread);
    };
    std::vector<std::thread> others;
    for (int thread = 1; thread < std::min(threads, items); ++thread) others.emplace_back(run, thread);
    run(0);
    for (auto& other : others) other.join();
}
