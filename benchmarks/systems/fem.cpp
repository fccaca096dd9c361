// Elastic solids of linear tetrahedra, as one writes them by hand: forces and stiffness of a tetrahedron in one pass
// from P and its tangent, ten of sixteen blocks computed, block rows of 3 x 3 doubles, conjugate gradients on them.
// With OpenMP each thread owns a stretch of vertices and writes the rows of those alone: no atomics, but tetrahedra
// between two stretches are computed by both.
#include <cmath>
#include <cstdint>
#include <cstring>
#ifdef _OPENMP
#include <omp.h>
#endif

namespace {

struct Vec {
    double x[3];
    double operator[](int i) const { return x[i]; }
    double &operator[](int i) { return x[i]; }
};

struct Mat {
    double x[3][3];
    const double *operator[](int i) const { return x[i]; }
    double *operator[](int i) { return x[i]; }
};

inline double dot(const Vec &a, const Vec &b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

inline Vec times(const Mat &m, const Vec &v) {
    Vec r;
    for (int i = 0; i < 3; ++i) r[i] = m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2];
    return r;
}

// The parts of the blocks of a tetrahedron: block(i, j) = (g_i . s_j) I + a h_i h_j^T + b h_j h_i^T + (g_i . g_j) C.
struct Element {
    Vec gradient[4], stress[4], push[4], force[4];
    double along, across;
    Mat common;
};

// St. Venant-Kirchhoff: P = F S, S = lambda tr(E) I + 2 mu E, E = (F^T F - I) / 2.
struct StVenantKirchhoff {
    static void compute(const Mat &F, double lambda, double mu, Element &element) {
        Mat S, B;
        for (int i = 0; i < 3; ++i)
            for (int j = i; j < 3; ++j) {
                S[i][j] = S[j][i] = mu * (F[0][i] * F[0][j] + F[1][i] * F[1][j] + F[2][i] * F[2][j]);
                B[i][j] = B[j][i] = mu * (F[i][0] * F[j][0] + F[i][1] * F[j][1] + F[i][2] * F[j][2]);
            }
        const double pressure = 0.5 * lambda * ((S[0][0] + S[1][1] + S[2][2]) / mu - 3) - mu;
        for (int i = 0; i < 3; ++i) S[i][i] += pressure;
        for (int i = 0; i < 4; ++i) {
            element.push[i] = times(F, element.gradient[i]);
            element.stress[i] = times(S, element.gradient[i]);
            element.force[i] = times(F, element.stress[i]);
        }
        element.along = lambda;
        element.across = mu;
        element.common = B;
    }
};

// Neo-Hookean: W = mu/2 (tr(F^T F) - 3) - mu ln J + lambda/2 (ln J)^2.
struct NeoHookean {
    static void compute(const Mat &F, double lambda, double mu, Element &element) {
        Mat T;  // F^-T, from the cofactors
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) {
                const int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, d = (j + 2) % 3;
                T[i][j] = F[a][c] * F[b][d] - F[a][d] * F[b][c];
            }
        const double J = F[0][0] * T[0][0] + F[0][1] * T[0][1] + F[0][2] * T[0][2];
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) T[i][j] /= J;
        const double pressure = lambda * std::log(J) - mu;
        element.common = {};
        for (int i = 0; i < 3; ++i) element.common[i][i] = mu;
        for (int i = 0; i < 4; ++i) {
            element.push[i] = times(T, element.gradient[i]);
            const Vec drawn = times(F, element.gradient[i]);
            for (int k = 0; k < 3; ++k) element.force[i][k] = mu * drawn[k] + pressure * element.push[i][k];
            element.stress[i] = {};
        }
        element.along = lambda;
        element.across = -pressure;
    }
};

inline void add_block(double *block, double *mirrored, const Element &element, int i, int j, double volume) {
    const Vec &hi = element.push[i], &hj = element.push[j];
    const double straight = dot(element.gradient[i], element.stress[j]);
    const double common = dot(element.gradient[i], element.gradient[j]);
    Mat k;
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b)
            k[a][b] = volume * (element.along * hi[a] * hj[b] + element.across * hj[a] * hi[b] +
                                common * element.common[a][b] + (a == b ? straight : 0.0));
    if (block)
        for (int a = 0; a < 3; ++a)
            for (int b = 0; b < 3; ++b) block[3 * a + b] += k[a][b];
    if (mirrored)
        for (int a = 0; a < 3; ++a)
            for (int b = 0; b < 3; ++b) mirrored[3 * a + b] += k[b][a];
}

// Adds the tetrahedra that have a vertex in low..high to the rows of these.
template <class Model>
void add_rows(int64_t low, int64_t high, int64_t tetrahedra, const int32_t *corners, const int32_t *entries,
              const double *inverse, const double *volumes, double lambda, double mu, const double *moved,
              double *force, double *stiffness) {
    for (int64_t t = 0; t < tetrahedra; ++t) {
        const int32_t *v = corners + 4 * t, *e = entries + 16 * t;
        bool own[4], any = false;
        for (int i = 0; i < 4; ++i) any |= own[i] = v[i] >= low && v[i] < high;
        if (!any) continue;
        Element element;
        const double *g = inverse + 9 * t;
        Mat F = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
        for (int k = 0; k < 3; ++k) {
            element.gradient[0][k] = -g[k] - g[3 + k] - g[6 + k];
            for (int i = 1; i < 4; ++i) {
                element.gradient[i][k] = g[3 * (i - 1) + k];
                for (int a = 0; a < 3; ++a) F[a][k] += (moved[3 * v[i] + a] - moved[3 * v[0] + a]) * g[3 * (i - 1) + k];
            }
        }
        Model::compute(F, lambda, mu, element);
        const double volume = volumes[t];
        for (int i = 0; i < 4; ++i)
            if (own[i])
                for (int a = 0; a < 3; ++a) force[3 * v[i] + a] += volume * element.force[i][a];
        for (int i = 0; i < 4; ++i)
            for (int j = i; j < 4; ++j)
                if (own[i] || own[j])
                    add_block(own[i] ? stiffness + 9 * int64_t(e[4 * i + j]) : nullptr,
                              own[j] && j > i ? stiffness + 9 * int64_t(e[4 * j + i]) : nullptr, element, i, j, volume);
    }
}

template <class Model>
void assemble(int64_t vertices, const int32_t *first, int64_t tetrahedra, const int32_t *corners,
              const int32_t *entries, const double *inverse, const double *volumes, double lambda, double mu,
              const double *moved, double *force, double *stiffness) {
#pragma omp parallel
    {
        int64_t low = 0, high = vertices;
#ifdef _OPENMP
        low = vertices * omp_get_thread_num() / omp_get_num_threads();
        high = vertices * (omp_get_thread_num() + 1) / omp_get_num_threads();
#endif
        std::memset(force + 3 * low, 0, 24 * (high - low));
        std::memset(stiffness + 9 * int64_t(first[low]), 0, 72 * int64_t(first[high] - first[low]));
        add_rows<Model>(low, high, tetrahedra, corners, entries, inverse, volumes, lambda, mu, moved, force, stiffness);
    }
}

inline void multiply_row(int64_t v, const int32_t *first, const int32_t *head, const double *matrix, const double *p,
                         double *sum) {
    sum[0] = sum[1] = sum[2] = 0;
    for (int32_t e = first[v]; e < first[v + 1]; ++e) {
        const double *m = matrix + 9 * int64_t(e), *x = p + 3 * int64_t(head[e]);
        for (int a = 0; a < 3; ++a) sum[a] += m[3 * a] * x[0] + m[3 * a + 1] * x[1] + m[3 * a + 2] * x[2];
    }
}

}  // namespace

extern "C" void stvk(int64_t vertices, const int32_t *first, int64_t tetrahedra, const int32_t *corners,
                     const int32_t *entries, const double *inverse, const double *volumes, double lambda, double mu,
                     const double *moved, double *force, double *stiffness) {
    assemble<StVenantKirchhoff>(vertices, first, tetrahedra, corners, entries, inverse, volumes, lambda, mu, moved,
                                force, stiffness);
}

extern "C" void neohookean(int64_t vertices, const int32_t *first, int64_t tetrahedra, const int32_t *corners,
                           const int32_t *entries, const double *inverse, const double *volumes, double lambda,
                           double mu, const double *moved, double *force, double *stiffness) {
    assemble<NeoHookean>(vertices, first, tetrahedra, corners, entries, inverse, volumes, lambda, mu, moved, force,
                         stiffness);
}

// At most so many iterations of conjugate gradients on matrix x = b from x = 0, until the residual is smaller than b by
// the factor `tolerance`. The preconditioner is given as its diagonal; what has none (0) stays where it is.
extern "C" void block_cg(int64_t iterations, double tolerance, int64_t n, const int32_t *first, const int32_t *head,
                         const double *matrix, const double *preconditioner, const double *b, double *x, double *r,
                         double *p, double *product) {
    double rz = 0, bb = 0, rr = 0;
#pragma omp parallel for reduction(+ : rz, bb)
    for (int64_t i = 0; i < 3 * n; ++i) {
        x[i] = 0;
        r[i] = b[i];
        p[i] = preconditioner[i] * b[i];
        rz += r[i] * p[i];
        bb += b[i] * b[i];
    }
    for (int64_t iteration = 0; iteration < iterations; ++iteration) {
        if (iteration && rr <= tolerance * tolerance * bb) break;
        double along = 0, fresh = 0;
        rr = 0;
#pragma omp parallel for reduction(+ : along)
        for (int64_t v = 0; v < n; ++v) {
            double sum[3];
            multiply_row(v, first, head, matrix, p, sum);
            for (int a = 0; a < 3; ++a) {
                product[3 * v + a] = sum[a];
                along += p[3 * v + a] * sum[a];
            }
        }
        const double alpha = rz / along;
#pragma omp parallel for reduction(+ : fresh, rr)
        for (int64_t i = 0; i < 3 * n; ++i) {
            x[i] += alpha * p[i];
            r[i] -= alpha * product[i];
            fresh += r[i] * preconditioner[i] * r[i];
            rr += preconditioner[i] != 0 ? r[i] * r[i] : 0;
        }
        const double beta = fresh / rz;
        rz = fresh;
#pragma omp parallel for
        for (int64_t i = 0; i < 3 * n; ++i) p[i] = preconditioner[i] * r[i] + beta * p[i];
    }
}

namespace {

// A linearised step of backward Euler, A dv = h (f_ext - f - (h K + D) v) with A = M + h D + h^2 K and D = a M + b K,
// the stiffness in `matrix` turned into A in place. `mass` belongs to the edges, `load` is f_ext.
template <class Model>
void step(int64_t iterations, double tolerance, int64_t vertices, const int32_t *first, const int32_t *head,
          const int32_t *diagonal, int64_t tetrahedra, const int32_t *corners, const int32_t *entries,
          const double *inverse, const double *volumes, double lambda, double mu, const double *mass,
          const double *load, const double *is_free, double h, double damp_mass, double damp_stiffness, double *moved,
          double *velocity, double *force, double *matrix, double *preconditioner, double *b, double *x, double *r,
          double *p, double *product) {
    assemble<Model>(vertices, first, tetrahedra, corners, entries, inverse, volumes, lambda, mu, moved, force, matrix);
#pragma omp parallel for
    for (int64_t v = 0; v < vertices; ++v) {
        double sum[3] = {};
        for (int32_t e = first[v]; e < first[v + 1]; ++e) {
            double *m = matrix + 9 * int64_t(e);
            const double *w = velocity + 3 * int64_t(head[e]);
            for (int a = 0; a < 3; ++a) {
                const double stretched = m[3 * a] * w[0] + m[3 * a + 1] * w[1] + m[3 * a + 2] * w[2];
                sum[a] += (h + damp_stiffness) * stretched + damp_mass * mass[e] * w[a];
            }
            for (int k = 0; k < 9; ++k)
                m[k] = (h * damp_stiffness + h * h) * m[k] + (k % 4 ? 0.0 : (1 + h * damp_mass) * mass[e]);
        }
        for (int a = 0; a < 3; ++a) {
            b[3 * v + a] = h * (load[3 * v + a] - force[3 * v + a] - sum[a]) * is_free[v];
            preconditioner[3 * v + a] = is_free[v] / matrix[9 * int64_t(diagonal[v]) + 4 * a];
        }
    }
    block_cg(iterations, tolerance, vertices, first, head, matrix, preconditioner, b, x, r, p, product);
#pragma omp parallel for
    for (int64_t i = 0; i < 3 * vertices; ++i) {
        velocity[i] += x[i];
        moved[i] += h * velocity[i];
    }
}

}  // namespace

extern "C" void stvk_step(int64_t iterations, double tolerance, int64_t vertices, const int32_t *first,
                          const int32_t *head, const int32_t *diagonal, int64_t tetrahedra, const int32_t *corners,
                          const int32_t *entries, const double *inverse, const double *volumes, double lambda,
                          double mu, const double *mass, const double *load, const double *is_free, double h,
                          double damp_mass, double damp_stiffness, double *moved, double *velocity, double *force,
                          double *matrix, double *preconditioner, double *b, double *x, double *r, double *p,
                          double *product) {
    step<StVenantKirchhoff>(iterations, tolerance, vertices, first, head, diagonal, tetrahedra, corners, entries,
                            inverse, volumes, lambda, mu, mass, load, is_free, h, damp_mass, damp_stiffness, moved,
                            velocity, force, matrix, preconditioner, b, x, r, p, product);
}

extern "C" void neohookean_step(int64_t iterations, double tolerance, int64_t vertices, const int32_t *first,
                                const int32_t *head, const int32_t *diagonal, int64_t tetrahedra,
                                const int32_t *corners, const int32_t *entries, const double *inverse,
                                const double *volumes, double lambda, double mu, const double *mass, const double *load,
                                const double *is_free, double h, double damp_mass, double damp_stiffness, double *moved,
                                double *velocity, double *force, double *matrix, double *preconditioner, double *b,
                                double *x, double *r, double *p, double *product) {
    step<NeoHookean>(iterations, tolerance, vertices, first, head, diagonal, tetrahedra, corners, entries, inverse,
                     volumes, lambda, mu, mass, load, is_free, h, damp_mass, damp_stiffness, moved, velocity, force,
                     matrix, preconditioner, b, x, r, p, product);
}
