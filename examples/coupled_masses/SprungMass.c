/* A mass on a spring and a damper whose other end is moved from outside:
 *
 *     m dv/dt = -k (x - x_other) - c (v - v_other),   dx/dt = v
 *
 * The other end is held during a step, as every input of an FMU is, so the error of a coupling is all in that.
 */
#include "model.h"

void model_initialize(double *x)
{
    x[X_x] = x[X_x0];
    x[X_v] = x[X_v0];
}

static double acceleration(const double *x, double position, double velocity)
{
    return -(x[X_k] * (position - x[X_x_other]) + x[X_c] * (velocity - x[X_v_other])) / x[X_m];
}

int model_step(double *x, double h)
{
    const double parts = h / x[X_max_substep];
    const int count = parts < 1.0 ? 1 : (int)(parts + 1.0);
    const double d = h / count;
    int i;

    for (i = 0; i < count; ++i) {
        const double p = x[X_x], v = x[X_v];
        const double a1 = acceleration(x, p, v);
        const double v2 = v + 0.5 * d * a1, a2 = acceleration(x, p + 0.5 * d * v, v2);
        const double v3 = v + 0.5 * d * a2, a3 = acceleration(x, p + 0.5 * d * v2, v3);
        const double v4 = v + d * a3, a4 = acceleration(x, p + d * v3, v4);

        x[X_x] = p + d * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0;
        x[X_v] = v + d * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0;
    }
    return 0;
}
