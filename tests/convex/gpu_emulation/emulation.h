// What render/gpu needs of CUDA, on the CPU: a block is 256 threads, blocks run one after the other.
#pragma once

#include <algorithm>
#include <atomic>
#include <barrier>
#include <cmath>

#define __device__
#define __global__
#define __shared__ static
using std::max, std::min;

struct Index { int x, y; };
inline thread_local Index threadIdx, blockIdx;
inline Index blockDim{256, 1};
inline std::barrier<> block_barrier(256);
inline std::atomic<int> agreeing[2];
inline thread_local int turn = 0;

inline void __syncthreads() { block_barrier.arrive_and_wait(); }
inline bool __syncthreads_and(bool value) {
    auto& count = agreeing[turn ^= 1];
    if (value) ++count;
    __syncthreads();
    const bool all = count == 256;
    __syncthreads();
    if (threadIdx.x == 0) count = 0;
    __syncthreads();
    return all;
}
inline void atomicOr(unsigned* to, unsigned bits) { std::atomic_ref<unsigned>(*to).fetch_or(bits); }
inline int __ffs(int bits) { return __builtin_ffs(bits); }
inline bool any_in_warp(bool) { return true; }
inline void add(float* to, float value) { if (value != 0.0f) std::atomic_ref<float>(*to).fetch_add(value); }
