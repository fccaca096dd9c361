// A step of a fluid among frequencies without its transforms, in plain C++: what examples/fluids_fft.py does in kernels.
// Compiled without -fopenmp for one thread and with it for several.
#include <algorithm>
#include <cmath>
#include <cstdint>

static inline int wrapped(int i, int n) { return i >= 0 && i < n ? i : ((i % n) + n) % n; }

static void advect(int n, const float *__restrict u, const float *__restrict v, float *__restrict carried_u,
                   float *__restrict carried_v, float dt) {
    const float cells = dt * n;
#pragma omp parallel for
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
            const int64_t c = int64_t(i) * n + j;
            const float x = i - cells * u[c], y = j - cells * v[c];
            const float low_x = std::floor(x), low_y = std::floor(y);
            const float a = x - low_x, b = y - low_y;
            const int i0 = wrapped(int(low_x), n), j0 = wrapped(int(low_y), n);
            const int i1 = i0 + 1 < n ? i0 + 1 : 0, j1 = j0 + 1 < n ? j0 + 1 : 0;
            const int64_t c00 = int64_t(i0) * n + j0, c01 = int64_t(i0) * n + j1;
            const int64_t c10 = int64_t(i1) * n + j0, c11 = int64_t(i1) * n + j1;
            const float w00 = (1 - a) * (1 - b), w01 = (1 - a) * b, w10 = a * (1 - b), w11 = a * b;
            carried_u[c] = w00 * u[c00] + w10 * u[c10] + w01 * u[c01] + w11 * u[c11];
            carried_v[c] = w00 * v[c00] + w10 * v[c10] + w01 * v[c01] + w11 * v[c11];
        }
}

static void diffuse_and_project(int n, float *__restrict u, float *__restrict v, float spread) {
    const int columns = n / 2 + 1;
#pragma omp parallel for
    for (int i = 0; i < n; ++i) {
        const float kx = 2 * i <= n ? i : i - n;
        for (int j = 0; j < columns; ++j) {
            const float ky = j, square = kx * kx + ky * ky;
            const float decay = 1 / (1 + spread * square), scale = 1 / std::max(square, 1.0f);
            for (int part = 0; part < 2; ++part) {
                const int64_t at = 2 * (int64_t(i) * columns + j) + part;
                const float along = scale * (kx * u[at] + ky * v[at]);
                u[at] = decay * (u[at] - kx * along);
                v[at] = decay * (v[at] - ky * along);
            }
        }
    }
}

static void move(int n, const float *__restrict u, const float *__restrict v, float *__restrict pos, float dt) {
#pragma omp parallel for
    for (int64_t p = 0; p < int64_t(n) * n; ++p) {
        const float x = pos[2 * p], y = pos[2 * p + 1];
        const int64_t c = int64_t(wrapped(int(std::floor(x * n)), n)) * n + wrapped(int(std::floor(y * n)), n);
        const float to_x = x + dt * u[c], to_y = y + dt * v[c];
        pos[2 * p] = to_x - std::floor(to_x);
        pos[2 * p + 1] = to_y - std::floor(to_y);
    }
}

extern "C" void fluid(int64_t n, const float *u, const float *v, float *carried_u, float *carried_v, float *waves_u,
                      float *waves_v, float *pos, float dt, float spread) {
    advect(n, u, v, carried_u, carried_v, dt);
    diffuse_and_project(n, waves_u, waves_v, spread);
    move(n, u, v, pos, dt);
}
