// The programs in plain C++, as one writes them by hand: a loop over a CSR index, arrays of numbers.
// Compiled without -fopenmp for one thread and with it for several.
#include <cmath>
#include <cstdint>

struct Vec {
    float x, y, z;
};

static inline Vec pull(const float *q, int64_t tail, int64_t head, float rest_len, float stiffness) {
    const float dx = q[3 * head] - q[3 * tail], dy = q[3 * head + 1] - q[3 * tail + 1],
                dz = q[3 * head + 2] - q[3 * tail + 2];
    const float length = std::sqrt(dx * dx + dy * dy + dz * dz);
    const float scale = length > 0 ? rest_len / length : 0;
    return {stiffness * (scale * dx - dx), stiffness * (scale * dy - dy), stiffness * (scale * dz - dz)};
}

static inline void add(float *force, int64_t v, Vec f) {
#pragma omp atomic
    force[3 * v] += f.x;
#pragma omp atomic
    force[3 * v + 1] += f.y;
#pragma omp atomic
    force[3 * v + 2] += f.z;
}

static void move(int64_t vertices, float *q, float *qd, float *force, const float *mass, float dt) {
#pragma omp parallel for
    for (int64_t v = 0; v < vertices; ++v) {
        for (int i = 0; i < 3; ++i) {
            const float qdd = force[3 * v + i] / mass[v];
            q[3 * v + i] += qd[3 * v + i] * dt + 0.5f * qdd * dt * dt;
            qd[3 * v + i] += qdd * dt;
            force[3 * v + i] = 0;
        }
    }
}

extern "C" void gather(int64_t vertices, const int32_t *first, const int32_t *head, const float *rest_len, float *q,
                       float *qd, float *force, const float *mass, float stiffness, float dt) {
#pragma omp parallel for
    for (int64_t v = 0; v < vertices; ++v) {
        Vec sum = {force[3 * v], force[3 * v + 1], force[3 * v + 2]};
        for (int32_t e = first[v]; e < first[v + 1]; ++e) {
            const Vec f = pull(q, v, head[e], rest_len[e], stiffness);
            sum.x += f.x;
            sum.y += f.y;
            sum.z += f.z;
        }
        force[3 * v] = sum.x;
        force[3 * v + 1] = sum.y;
        force[3 * v + 2] = sum.z;
    }
    move(vertices, q, qd, force, mass, dt);
}

extern "C" void scatter(int64_t vertices, int64_t edges, const int32_t *tail, const int32_t *head,
                        const float *rest_len, float *q, float *qd, float *force, const float *mass, float stiffness,
                        float dt) {
#pragma omp parallel for
    for (int64_t e = 0; e < edges; ++e) add(force, tail[e], pull(q, tail[e], head[e], rest_len[e], stiffness));
    move(vertices, q, qd, force, mass, dt);
}

extern "C" void both_ends(int64_t vertices, int64_t edges, const int32_t *tail, const int32_t *head,
                          const float *rest_len, float *q, float *qd, float *force, const float *mass, float stiffness,
                          float dt) {
#pragma omp parallel for
    for (int64_t e = 0; e < edges; ++e) {
        const Vec f = pull(q, tail[e], head[e], rest_len[e], stiffness);
        add(force, tail[e], f);
        add(force, head[e], {-f.x, -f.y, -f.z});
    }
    move(vertices, q, qd, force, mass, dt);
}

extern "C" void axpy(int64_t rows, float a, const float *__restrict x, float *__restrict y) {
#pragma omp parallel for simd
    for (int64_t i = 0; i < rows; ++i) y[i] = a * x[i] + y[i];
}

extern "C" void axpy_times(int64_t times, void (*step)(int64_t, float, const float *, float *), int64_t rows, float a,
                           const float *x, float *y) {
    for (int64_t i = 0; i < times; ++i) step(rows, a, x, y);
}

extern "C" void stencil(int64_t n, const float *__restrict old, float *__restrict fresh, float center, float side) {
#pragma omp parallel for
    for (int64_t i = 1; i < n - 1; ++i)
        for (int64_t j = 1; j < n - 1; ++j) {
            const float *c = old + (i * n + j) * n;
            float *out = fresh + (i * n + j) * n;
            for (int64_t k = 1; k < n - 1; ++k)
                out[k] = center * c[k] +
                         side * (c[k - n * n] + c[k + n * n] + c[k - n] + c[k + n] + c[k - 1] + c[k + 1]);
        }
}

extern "C" void heat(int64_t vertices, const int32_t *first, const int32_t *head, const float *weight,
                     const float *rate, const float *__restrict old, float *__restrict fresh) {
#pragma omp parallel for
    for (int64_t v = 0; v < vertices; ++v) {
        float flow = 0;
        for (int32_t e = first[v]; e < first[v + 1]; ++e) flow += weight[e] * (old[head[e]] - old[v]);
        fresh[v] = old[v] + rate[v] * flow;
    }
}

static inline int64_t wrapped(int64_t index, int64_t n) { return index < 0 ? index + n : index >= n ? index - n : index; }

// Moves a particle that lies (x, y) above the centre of the cell (i, j) by the flow that is interpolated there.
static inline void carry(float *pos, const float *vel, int64_t n, int64_t i, int64_t j, float x, float y, float dt) {
    const int64_t i0 = i * n, i1 = wrapped(i + 1, n) * n, j1 = wrapped(j + 1, n);
    for (int d = 0; d < 2; ++d) {
        const float low = (1 - x) * vel[2 * (i0 + j) + d] + x * vel[2 * (i1 + j) + d];
        const float high = (1 - x) * vel[2 * (i0 + j1) + d] + x * vel[2 * (i1 + j1) + d];
        const float moved = pos[d] + dt * ((1 - y) * low + y * high);
        pos[d] = moved - std::floor(moved);
    }
}

extern "C" void particles(int64_t count, int64_t n, float *__restrict pos, const float *__restrict vel, float dt) {
#pragma omp parallel for
    for (int64_t p = 0; p < count; ++p) {
        const float x = pos[2 * p] * float(n) - 0.5f, y = pos[2 * p + 1] * float(n) - 0.5f;
        const float i = std::floor(x), j = std::floor(y);
        carry(pos + 2 * p, vel, n, wrapped(int64_t(i), n), wrapped(int64_t(j), n), x - i, y - j, dt);
    }
}

extern "C" void particles_keys(int64_t count, int64_t n, float *__restrict pos, int32_t *__restrict cell,
                               const float *__restrict vel, float dt) {
#pragma omp parallel for
    for (int64_t p = 0; p < count; ++p) {
        const int32_t i = cell[p] / int32_t(n), j = cell[p] % int32_t(n);
        float x = pos[2 * p] * float(n) - 0.5f - i, y = pos[2 * p + 1] * float(n) - 0.5f - j;
        x = x < 0 ? x + n : x, y = y < 0 ? y + n : y;  // before the centre of the first cell
        carry(pos + 2 * p, vel, n, i, j, x, y, dt);
        const float at_x = std::floor(pos[2 * p] * float(n) - 0.5f), at_y = std::floor(pos[2 * p + 1] * float(n) - 0.5f);
        cell[p] = int32_t(wrapped(int64_t(at_x), n) * n + wrapped(int64_t(at_y), n));
    }
}

extern "C" void pcg(int64_t iterations, int64_t n, const int32_t *first, const int32_t *head, const float *weight,
                    const float *diagonal, const float *b, float *x, float *r, float *p, float *product) {
    double rz = 0;
#pragma omp parallel for reduction(+ : rz)
    for (int64_t v = 0; v < n; ++v) {
        x[v] = 0;
        r[v] = b[v];
        p[v] = b[v] / diagonal[v];
        rz += r[v] * p[v];
    }
    for (int64_t iteration = 0; iteration < iterations; ++iteration) {
        double along = 0, fresh = 0;
#pragma omp parallel for reduction(+ : along)
        for (int64_t v = 0; v < n; ++v) {
            float sum = diagonal[v] * p[v];
            for (int32_t e = first[v]; e < first[v + 1]; ++e) sum -= weight[e] * p[head[e]];
            product[v] = sum;
            along += p[v] * sum;
        }
        const float alpha = float(rz / along);
#pragma omp parallel for reduction(+ : fresh)
        for (int64_t v = 0; v < n; ++v) {
            x[v] += alpha * p[v];
            r[v] -= alpha * product[v];
            fresh += r[v] * r[v] / diagonal[v];
        }
        const float beta = float(fresh / rz);
        rz = fresh;
#pragma omp parallel for
        for (int64_t v = 0; v < n; ++v) p[v] = r[v] / diagonal[v] + beta * p[v];
    }
}

extern "C" void triad(int64_t rows, float *__restrict a, const float *__restrict b, const float *__restrict c,
                      float s) {
#pragma omp parallel for simd
    for (int64_t i = 0; i < rows; ++i) a[i] = b[i] + s * c[i];
}

#ifdef __AVX512F__
constexpr int LANES = 16, CHAINS = 16;
#else
constexpr int LANES = 8, CHAINS = 12;
#endif
typedef float Lanes __attribute__((vector_size(4 * LANES)));

// Independent chains of multiply-adds: enough to hide the latency, few enough for the registers. All numbers come from
// `out` and go back there, so that nothing can be computed beforehand.
extern "C" void fma_chains(int64_t chain_steps, int threads, float *out) {
    float total = 0;
#pragma omp parallel for reduction(+ : total) schedule(static, 1)
    for (int thread = 0; thread < threads; ++thread) {
        const Lanes start = Lanes{} + *out, factor = start + 0.5f;
        Lanes chain[CHAINS];
        for (int i = 0; i < CHAINS; ++i) chain[i] = start * float(i);
        for (int64_t t = 0; t < chain_steps / (CHAINS * LANES) / threads; ++t) {
#pragma GCC unroll 16
            for (int i = 0; i < CHAINS; ++i) chain[i] = chain[i] * factor + start;
        }
        for (int i = 0; i < CHAINS; ++i)
            for (int lane = 0; lane < LANES; ++lane) total += chain[i][lane];
    }
    *out = total;
}
