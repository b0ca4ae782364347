/* A pendulum on a cart: a force pushes the cart, the pendulum swings freely about a pivot on it; angle = 0 stands upright.
 *
 *     (M + m) a + m l (alpha cos(angle) - rate^2 sin(angle)) = force - c v
 *     (I + m l^2) alpha + m l a cos(angle) = m g l sin(angle) - b rate + torque
 *
 * with a, alpha the accelerations of cart and angle, l from the pivot to the pendulum's centre of mass and I its moment of
 * inertia about that. Force and torque are held during a step, which runge_kutta.h integrates.
 */
#include "elementary.h"
#include "model.h"

#define STATES 4

static void derivative(const double *x, const double *s, double *ds)
{
    const double ml = x[X_m] * x[X_l], c = cosine(s[1]), d = sine(s[1]);
    const double M11 = x[X_M_cart] + x[X_m], M12 = ml * c, M22 = x[X_I] + ml * x[X_l];
    const double f1 = x[X_force] - x[X_c] * s[2] + ml * s[3] * s[3] * d;
    const double f2 = ml * x[X_g] * d - x[X_b] * s[3] + x[X_torque];
    const double determinant = M11 * M22 - M12 * M12;

    ds[0] = s[2];
    ds[1] = s[3];
    ds[2] = (M22 * f1 - M12 * f2) / determinant;
    ds[3] = (M11 * f2 - M12 * f1) / determinant;
}

#include "runge_kutta.h"

void model_initialize(double *x)
{
    x[X_position] = x[X_position_0];
    x[X_angle] = x[X_angle_0];
    x[X_velocity] = x[X_velocity_0];
    x[X_rate] = x[X_rate_0];
}

int model_step(double *x, double h)
{
    double s[STATES] = { x[X_position], x[X_angle], x[X_velocity], x[X_rate] };
    const int status = integrate(x, h, s);

    x[X_position] = s[0];
    x[X_angle] = s[1];
    x[X_velocity] = s[2];
    x[X_rate] = s[3];
    return status;
}
