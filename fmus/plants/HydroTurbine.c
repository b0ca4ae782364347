/* A water turbine at the end of a long penstock, per unit: opening the gate first lowers the power, for the water must be
 * brought to move (the non-minimum-phase plant of Kundur, Power System Stability and Control, section 9.1).
 *
 *     Tg d(gate)/dt = command - gate,    Tw d(flow)/dt = head - (flow / gate)^2,    power = flow (flow / gate)^2
 *
 * Tw is the time in which the head brings the water to its rated flow. The step fails with code 3 where the gate is shut:
 * command and gate must stay above zero. The command is held during a step, which runge_kutta.h integrates.
 */
#include "model.h"

#define STATES 2

static void derivative(const double *x, const double *s, double *ds)
{
    const double root = s[1] / s[0];

    ds[0] = (x[X_command] - s[0]) / x[X_Tg];
    ds[1] = (x[X_head] - root * root) / x[X_Tw];
}

#include "runge_kutta.h"

static void write_outputs(double *x, const double *s)
{
    const double root = s[1] / s[0];

    x[X_gate] = s[0];
    x[X_flow] = s[1];
    x[X_power] = s[1] * root * root;
}

void model_initialize(double *x)
{
    const double s[STATES] = { x[X_gate_0], x[X_gate_0] * sqrt(x[X_head]) };

    write_outputs(x, s);
}

int model_step(double *x, double h)
{
    double s[STATES] = { x[X_gate], x[X_flow] };
    const int status = integrate(x, h, s);

    if (!(s[0] > 0.0)) {
        return 3;
    }
    write_outputs(x, s);
    return status;
}
