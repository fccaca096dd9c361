// Stencils in plain C++, as one writes them by hand.
#include <cstdint>

extern "C" void stencil27(int64_t n, const float *__restrict old, float *__restrict fresh, float w0, float w1, float w2,
                          float w3) {
#pragma omp parallel for
    for (int64_t i = 1; i < n - 1; ++i)
        for (int64_t j = 1; j < n - 1; ++j) {
            const float *c = old + (i * n + j) * n;
            float *out = fresh + (i * n + j) * n;
            const auto faces = [&](int64_t k) { return c[k - n * n] + c[k + n * n] + c[k - n] + c[k + n]; };
            const auto corners = [&](int64_t k) {
                return c[k - n * n - n] + c[k - n * n + n] + c[k + n * n - n] + c[k + n * n + n];
            };
            const auto side = [&](int64_t k) { return w1 * c[k] + w2 * faces(k) + w3 * corners(k); };
            for (int64_t k = 1; k < n - 1; ++k)
                out[k] = w0 * c[k] + w1 * faces(k) + w2 * corners(k) + side(k - 1) + side(k + 1);
        }
}

extern "C" void periodic(int64_t n, const float *__restrict old, float *__restrict fresh, float center, float side) {
#pragma omp parallel for
    for (int64_t i = 0; i < n; ++i) {
        const int64_t below = i == 0 ? n - 1 : i - 1, above = i == n - 1 ? 0 : i + 1;
        for (int64_t j = 0; j < n; ++j) {
            const int64_t left = j == 0 ? n - 1 : j - 1, right = j == n - 1 ? 0 : j + 1;
            const float *c = old + (i * n + j) * n;
            const float *b = old + (below * n + j) * n, *a = old + (above * n + j) * n;
            const float *l = old + (i * n + left) * n, *r = old + (i * n + right) * n;
            float *out = fresh + (i * n + j) * n;
            const auto cell = [&](int64_t k, int64_t before, int64_t after) {
                out[k] = center * c[k] + side * (b[k] + a[k] + l[k] + r[k] + c[before] + c[after]);
            };
            cell(0, n - 1, 1);
            for (int64_t k = 1; k < n - 1; ++k) cell(k, k - 1, k + 1);
            cell(n - 1, n - 2, 0);
        }
    }
}

extern "C" void jacobi(int64_t n, const float *__restrict old, float *__restrict fresh, float side) {
#pragma omp parallel for
    for (int64_t i = 1; i < n - 1; ++i) {
        const float *c = old + i * n;
        float *out = fresh + i * n;
        for (int64_t j = 1; j < n - 1; ++j) out[j] = side * (c[j - n] + c[j + n] + c[j - 1] + c[j + 1]);
    }
}
