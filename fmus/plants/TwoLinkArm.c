/* A robot arm with two links in a vertical plane, driven by a torque at each joint.
 *
 *     M(q) ddq + C(q, dq) dq + D dq + G(q) = torque
 *
 * q1 is the angle of the first link from the horizontal, q2 that of the second from the first; q = (-pi/2, 0) hangs down.
 * Torques are held during a communication step, which is cut into equal substeps of at most max_substep, each one step of
 * the classical fourth-order Runge-Kutta method: the work is known beforehand, and the same inputs give the same numbers.
 * A step fails with code 1 where max_substep is not a positive number, with code 2 where it would take more than
 * MOST_SUBSTEPS substeps.
 */
#include <math.h>

#include "model.h"

static const double MOST_SUBSTEPS = 1e6;

/* ds = d/dt s, where s = (q1, q2, dq1, dq2). */
static void derivative(const double *x, const double *s, double *ds)
{
    const double m1 = x[X_m1], m2 = x[X_m2], L1 = x[X_L1], Lg1 = x[X_Lg1], Lg2 = x[X_Lg2], g = x[X_g];
    const double c1 = cos(s[0]), c12 = cos(s[0] + s[1]), c2 = cos(s[1]), s2 = sin(s[1]);
    const double v1 = s[2], v2 = s[3], coupling = m2 * L1 * Lg2;

    const double M11 = x[X_I1] + x[X_I2] + m1 * Lg1 * Lg1 + m2 * (L1 * L1 + Lg2 * Lg2) + 2.0 * coupling * c2;
    const double M12 = x[X_I2] + m2 * Lg2 * Lg2 + coupling * c2;
    const double M22 = x[X_I2] + m2 * Lg2 * Lg2;
    const double centrifugal1 = -coupling * s2 * v2 * (2.0 * v1 + v2), centrifugal2 = coupling * s2 * v1 * v1;
    const double G2 = g * m2 * Lg2 * c12, G1 = g * (m1 * Lg1 + m2 * L1) * c1 + G2;

    const double torque1 = x[X_torque1] - centrifugal1 - x[X_D1] * v1 - G1;
    const double torque2 = x[X_torque2] - centrifugal2 - x[X_D2] * v2 - G2;
    const double determinant = M11 * M22 - M12 * M12;

    ds[0] = v1;
    ds[1] = v2;
    ds[2] = (M22 * torque1 - M12 * torque2) / determinant;
    ds[3] = (M11 * torque2 - M12 * torque1) / determinant;
}

/* to = s + h ds */
static void ahead(const double *s, double h, const double *ds, double *to)
{
    int i;

    for (i = 0; i < 4; ++i) {
        to[i] = s[i] + h * ds[i];
    }
}

static void runge_kutta(const double *x, double h, double *s)
{
    double k1[4], k2[4], k3[4], k4[4], inside[4];
    int i;

    derivative(x, s, k1);
    ahead(s, 0.5 * h, k1, inside);
    derivative(x, inside, k2);
    ahead(s, 0.5 * h, k2, inside);
    derivative(x, inside, k3);
    ahead(s, h, k3, inside);
    derivative(x, inside, k4);
    for (i = 0; i < 4; ++i) {
        s[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
}

static void write_outputs(double *x, const double *s)
{
    x[X_q1] = s[0];
    x[X_q2] = s[1];
    x[X_dq1] = s[2];
    x[X_dq2] = s[3];
    x[X_x] = x[X_L1] * cos(s[0]) + x[X_L2] * cos(s[0] + s[1]);
    x[X_y] = x[X_L1] * sin(s[0]) + x[X_L2] * sin(s[0] + s[1]);
}

void model_initialize(double *x)
{
    const double s[4] = { x[X_q1_0], x[X_q2_0], x[X_dq1_0], x[X_dq2_0] };

    write_outputs(x, s);
}

int model_step(double *x, double h)
{
    double s[4] = { x[X_q1], x[X_q2], x[X_dq1], x[X_dq2] };
    double substeps;
    long i, count;

    if (!(x[X_max_substep] > 0.0)) {
        return 1;
    }
    /* Less a little, so that a step size that was rounded up takes no substep more. */
    substeps = ceil(h / x[X_max_substep] * (1.0 - 1e-9));
    if (substeps > MOST_SUBSTEPS) {
        return 2;
    }
    count = substeps < 1.0 ? 1 : (long)substeps;
    for (i = 0; i < count; ++i) {
        runge_kutta(x, h / (double)count, s);
    }
    write_outputs(x, s);
    return 0;
}
