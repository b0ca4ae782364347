/* A car under cruise control: the discrete velocity map of the paper's second experiment, exactly.
 *
 *     v(t + h) = (1 - b/m h) v(t) + h/m force + disturbance
 *
 * It is the paper's map and not the solution of m dv/dt = force - b v, so h acts as a parameter: the paper uses 0.02 s.
 * The disturbance is a velocity, added once per communication step whatever its size: the process noise q of the paper,
 * drawn by whoever runs the loop, so that the plant itself is deterministic.
 */
#include "model.h"

void model_initialize(double *x)
{
    x[X_v] = x[X_v0];
}

int model_step(double *x, double h)
{
    const double force = x[X_force], disturbance = x[X_disturbance];
    const double b = x[X_b], m = x[X_m];
    double v = x[X_v];

    /* The order of the operations is part of the definition: other implementations agree with it bit for bit. */
    v = (1.0 - b / m * h) * v + h / m * force + disturbance;

    x[X_v] = v;
    return 0;
}
