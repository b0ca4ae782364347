/* Two masses on a rail with a spring and a damper between them; a force acts on each.
 *
 *     m1 dv1/dt = force1 + k (x2 - x1) + d (v2 - v1),    m2 dv2/dt = force2 - k (x2 - x1) - d (v2 - v1)
 *
 * x1 and x2 are measured from where the spring is at rest. Forces are held during a step, which runge_kutta.h integrates.
 */
#include "model.h"

#define STATES 4

static void derivative(const double *x, const double *s, double *ds)
{
    const double between = x[X_k] * (s[1] - s[0]) + x[X_d] * (s[3] - s[2]);

    ds[0] = s[2];
    ds[1] = s[3];
    ds[2] = (x[X_force1] + between) / x[X_m1];
    ds[3] = (x[X_force2] - between) / x[X_m2];
}

#include "runge_kutta.h"

void model_initialize(double *x)
{
    x[X_x1] = x[X_x1_0];
    x[X_x2] = x[X_x2_0];
    x[X_v1] = 0.0;
    x[X_v2] = 0.0;
}

int model_step(double *x, double h)
{
    double s[STATES] = { x[X_x1], x[X_x2], x[X_v1], x[X_v2] };
    const int status = integrate(x, h, s);

    x[X_x1] = s[0];
    x[X_x2] = s[1];
    x[X_v1] = s[2];
    x[X_v2] = s[3];
    return status;
}
