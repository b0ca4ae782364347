/* The cruise controller in a loop of C, as a timer of a microcontroller would call it; here it drives a car made of a line of C.
 *
 *     bayesftc export cruise_control --block controller --format c -o .
 *     cc -std=c99 -O2 main.c controller.c -lm && ./a.out
 */
#include <math.h>
#include <stdio.h>

#include "controller.h"

static controller brain; /* all that it remembers: sizeof brain bytes, known when this is compiled */

static double noise(void) /* of the sensors, standard deviation 1: sensors without any repeat themselves, as frozen ones do */
{
    static unsigned long random = 1;
    double total = -6.0;
    for (int i = 0; i < 12; ++i) {
        random = (1664525UL * random + 1013904223UL) & 0xffffffffUL;
        total += (double)random / 4294967296.0;
    }
    return total;
}

int main(void)
{
    controller_inputs u = { { 0.0 }, { 0.0 } };
    controller_outputs y;
    double speed = 20.0;

    controller_init(&brain);
    u.goal[0] = 25.0;
    for (int k = 0; k < 2000; ++k) { /* in firmware: the interrupt of a timer, every CONTROLLER_SECONDS */
        u.y[0] = k < 1000 ? speed + noise() : 20.0; /* in firmware: read the sensors; the first is stuck from 20 s on */
        u.y[1] = k % 10 == 0 ? (double)NAN : speed + noise(); /* a sample that is missing */
        controller_step(&brain, &u, &y);
        speed += CONTROLLER_SECONDS * (y.u[0] - 5.0 * speed) / 100.0; /* in firmware: hand y.u[0] to the actuator */
    }
    printf("%.3f m/s, precisions %.3g and %.3g, %u bytes\n", speed, y.precision[0], y.precision[1], (unsigned)sizeof brain);
    return 0;
}
