// The spring-mass step as one would write it by hand: CSR adjacency, one loop over vertices, float32.
// The peer of benchmarks/spring_mass.py.
#include <cmath>
#include <cstdint>

extern "C" void internal_forces(int64_t vertices, const int32_t *first, const int32_t *head, const float *rest_len,
                                const float *q, float *force, float stiffness) {
    for (int64_t v = 0; v < vertices; ++v) {
        float fx = force[3 * v], fy = force[3 * v + 1], fz = force[3 * v + 2];
        const float qx = q[3 * v], qy = q[3 * v + 1], qz = q[3 * v + 2];
        for (int32_t e = first[v]; e < first[v + 1]; ++e) {
            const int64_t h = head[e];
            const float dx = q[3 * h] - qx, dy = q[3 * h + 1] - qy, dz = q[3 * h + 2] - qz;
            const float length = std::sqrt(dx * dx + dy * dy + dz * dz);
            const float scale = length > 0 ? rest_len[e] / length : 0;
            fx += stiffness * (scale * dx - dx);
            fy += stiffness * (scale * dy - dy);
            fz += stiffness * (scale * dz - dz);
        }
        force[3 * v] = fx;
        force[3 * v + 1] = fy;
        force[3 * v + 2] = fz;
    }
}

extern "C" void apply_forces(int64_t vertices, float *q, float *qd, float *force, const float *mass, float dt) {
    for (int64_t v = 0; v < vertices; ++v) {
        for (int i = 0; i < 3; ++i) {
            const float qdd = force[3 * v + i] / mass[v];
            q[3 * v + i] += qd[3 * v + i] * dt + 0.5f * qdd * dt * dt;
            qd[3 * v + i] += qdd * dt;
            force[3 * v + i] = 0;
        }
    }
}
