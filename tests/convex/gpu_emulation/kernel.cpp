#define EMULATED
#include "emulation.h"
#include "kernel.cu"

#include "../render/hulls.h"
#include "hulls.cu"

#include <thread>
#include <vector>

template <class Kernel>
void launch(int columns, int rows, const Kernel& kernel) {
    std::vector<std::thread> threads;
    for (int thread = 0; thread < BLOCK; ++thread)
        threads.emplace_back([=] {
            threadIdx = {thread, 0};
            for (int row = 0; row < rows; ++row)
                for (int column = 0; column < columns; ++column) {
                    blockIdx = {column, row};
                    kernel();
                    __syncthreads();
                }
        });
    for (auto& thread : threads) thread.join();
}

extern "C" void run_blend(int columns, int rows, int w, int h, int m, const float* q, const int* s, const float* l,
                          const float* b, const float* o, const float* f, float* out, float* t, int* which) {
    launch(columns, rows, [=] { blend(w, h, m, q, s, l, b, o, f, out, t, which); });
}

extern "C" void run_gradient(int columns, int rows, int w, int h, int m, const float* q, const int* s, const float* l,
                             const float* b, const float* o, const float* f, const float* out, const float* t,
                             const float* go, const float* gt, float* gq, float* gl, float* gb, float* gop, float* gf) {
    launch(columns, rows, [=] { gradient(w, h, m, q, s, l, b, o, f, out, t, go, gt, gq, gl, gb, gop, gf); });
}

extern "C" void run_tangent(int columns, int rows, int w, int h, int m, const float* q, const int* s, const float* l,
                            const float* b, const float* o, const float* f, int directions, int line_count,
                            const float* dq, const float* dl, const float* db, const float* dop, const float* df,
                            float* out, float* t) {
    launch(columns, rows,
           [=] { tangent(w, h, m, q, s, l, b, o, f, directions, line_count, dq, dl, db, dop, df, out, t); });
}

extern "C" void run_hulls(int columns, int rows, int sets, int points, const double* given, long long* order,
                          long long* number, double* width) {
    launch(columns, rows, [=] { hulls(sets, points, given, order, number, width); });
}
