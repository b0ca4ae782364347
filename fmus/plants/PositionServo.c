/* A position servo: a voltage drives a current through a winding, the current a shaft with friction.
 *
 *     L di/dt = voltage - R i - K speed,    J d(speed)/dt = K i - b speed + load,    d(angle)/dt = speed
 *
 * Voltage and load torque are held during a step, which runge_kutta.h integrates.
 */
#include "model.h"

#define STATES 3

static void derivative(const double *x, const double *s, double *ds)
{
    ds[0] = s[1];
    ds[1] = (x[X_K] * s[2] - x[X_b] * s[1] + x[X_load]) / x[X_J];
    ds[2] = (x[X_voltage] - x[X_R] * s[2] - x[X_K] * s[1]) / x[X_L];
}

#include "runge_kutta.h"

void model_initialize(double *x)
{
    x[X_angle] = x[X_angle_0];
    x[X_speed] = 0.0;
    x[X_current] = 0.0;
}

int model_step(double *x, double h)
{
    double s[STATES] = { x[X_angle], x[X_speed], x[X_current] };
    const int status = integrate(x, h, s);

    x[X_angle] = s[0];
    x[X_speed] = s[1];
    x[X_current] = s[2];
    return status;
}
