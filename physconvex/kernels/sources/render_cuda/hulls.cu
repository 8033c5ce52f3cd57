// Follows cpu/hulls.h in the text that is compiled: one thread for each hull.
extern "C" __global__ void hulls(int sets, int points, const double* given, long long* order, long long* number,
                                 double* width) {
    const int set = blockIdx.x * blockDim.x + threadIdx.x;
    if (set >= sets) return;
    const long long base = static_cast<long long>(set) * points;
    const double* p = given + 2 * base;
    wrap(points, p, order + base, number + set);
    width[set] = least_width(points, p, order + base, static_cast<int>(number[set]));
}
