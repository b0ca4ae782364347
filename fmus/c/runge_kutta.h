/* The classical fourth-order Runge-Kutta method, for models that are ordinary differential equations.
 *
 * Before it is included, STATES is their number and derivative(x, s, ds) is defined: ds = d/dt s for the states s, with inputs
 * and parameters in x. A communication step is cut into equal substeps of at most x[X_max_substep]: the work is known
 * beforehand, and the same inputs give the same numbers.
 */
#ifndef BAYESFTC_RUNGE_KUTTA_H
#define BAYESFTC_RUNGE_KUTTA_H

#include <math.h>

static const double MOST_SUBSTEPS = 1e6;

/* to = s + h ds */
static void ahead(const double *s, double h, const double *ds, double *to)
{
    int i;

    for (i = 0; i < STATES; ++i) {
        to[i] = s[i] + h * ds[i];
    }
}

static void runge_kutta(const double *x, double h, double *s)
{
    double k1[STATES], k2[STATES], k3[STATES], k4[STATES], inside[STATES];
    int i;

    derivative(x, s, k1);
    ahead(s, 0.5 * h, k1, inside);
    derivative(x, inside, k2);
    ahead(s, 0.5 * h, k2, inside);
    derivative(x, inside, k3);
    ahead(s, h, k3, inside);
    derivative(x, inside, k4);
    for (i = 0; i < STATES; ++i) {
        s[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
}

/* Take s from t to t + h. Returns 0; 1 where max_substep is not a positive number; 2 where it is too small. */
static int integrate(const double *x, double h, double *s)
{
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
    return 0;
}

#endif
