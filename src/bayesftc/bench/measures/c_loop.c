/* The loop of plain_loop.py as one would write it in C: read the speed, compute the force, set it, make the step. */
#include "fmi_calls.h"

/* Record the output of every `every`-th step; return 0, or 1 if the FMU refused a call. */
EXPORT int c_loop(void *component, Get get, Set set, Step step, unsigned int output, unsigned int input, double gain,
                  double offset, double h, long long steps, long long every, double *recording)
{
    long long next = 0;

    for (long long k = 0;; ++k) {
        double v, u;

        if (get(component, &output, 1, &v) > WARNING) {
            return 1;
        }
        u = offset + gain * v;
        if (k == next) {
            *recording++ = v;
            next += every;
        }
        if (k == steps) {
            return 0;
        }
        if (set(component, &input, 1, &u) > WARNING || step(component, (double)k * h, h, 1) > WARNING) {
            return 1;
        }
    }
}
