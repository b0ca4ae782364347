/* A robot arm with two links in a vertical plane, driven by a torque at each joint.
 *
 *     M(q) ddq + C(q, dq) dq + D dq + G(q) = torque
 *
 * q1 is the angle of the first link from the horizontal, q2 that of the second from the first; q = (-pi/2, 0) hangs down.
 * Torques are held during a communication step, which runge_kutta.h integrates. A step fails with code 1 where max_substep is
 * not a positive number, with code 2 where it would take more than MOST_SUBSTEPS substeps.
 */
#include "elementary.h"
#include "model.h"

#define STATES 4

/* ds = d/dt s, where s = (q1, q2, dq1, dq2). */
static void derivative(const double *x, const double *s, double *ds)
{
    const double m1 = x[X_m1], m2 = x[X_m2], L1 = x[X_L1], Lg1 = x[X_Lg1], Lg2 = x[X_Lg2], g = x[X_g];
    const double c1 = cosine(s[0]), c12 = cosine(s[0] + s[1]), c2 = cosine(s[1]), s2 = sine(s[1]);
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

#include "runge_kutta.h"

static void write_outputs(double *x, const double *s)
{
    x[X_q1] = s[0];
    x[X_q2] = s[1];
    x[X_dq1] = s[2];
    x[X_dq2] = s[3];
    x[X_x] = x[X_L1] * cosine(s[0]) + x[X_L2] * cosine(s[0] + s[1]);
    x[X_y] = x[X_L1] * sine(s[0]) + x[X_L2] * sine(s[0] + s[1]);
}

void model_initialize(double *x)
{
    const double s[STATES] = { x[X_q1_0], x[X_q2_0], x[X_dq1_0], x[X_dq2_0] };

    write_outputs(x, s);
}

int model_step(double *x, double h)
{
    double s[STATES] = { x[X_q1], x[X_q2], x[X_dq1], x[X_dq2] };
    const int status = integrate(x, h, s);

    if (status == 0) {
        write_outputs(x, s);
    }
    return status;
}
