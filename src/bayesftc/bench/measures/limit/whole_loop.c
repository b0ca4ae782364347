/* The loop of full_loop.py as one would write it by hand for this one experiment: a car as an FMU, two noisy sensors of its speed,
 * one of which freezes, a Kalman filter that learns both precisions, and a controller that follows a sine.
 *
 * The random numbers are those of the engine to the last place of log, and as there they are drawn for 64 steps at a time. Each
 * part can be left out, by a constant that the compiler knows: what is left out costs nothing.
 *
 * This filter and controller are for one state and two sensors that always send. In a second loop the exported C of the engine's
 * controller is in their place, which also bears missing and absurd samples, checks its model, and computes all outputs. */
#include <math.h>
#include <stdint.h>

#include "../fmi_calls.h"
#include "controller.c" /* exported */

typedef struct {
    void *component;
    Get get;
    Set set;
    Step step;
    unsigned int output, inputs[2];
} Car;

typedef struct {
    double step, a, b, process_variance, sensor_std, forgetting, prior_shape, start_speed, amplitude, period, offset;
    long long fault_start, fault_stop;
    uint64_t seed, keys[3], channels[3]; /* of the disturbance and of both sensors' noise */
} Setting;

enum { CHUNK = 64, STREAMS = 3, COLUMNS = 8 };
enum { RANDOM = 1, FMU = 2, CONTROL = 4, RECORD = 8, EXPORTED = 16 };

static void philox(uint64_t c0, uint64_t c1, uint64_t k0, uint64_t k1, uint64_t *words)
{
    uint64_t c2 = 0, c3 = 0;

    for (int i = 0; i < 10; ++i) {
        unsigned __int128 p = (unsigned __int128)0xD2E7470EE14C6C93u * c0, q = (unsigned __int128)0xCA5A826395121157u * c2;

        c0 = (uint64_t)(q >> 64) ^ c1 ^ k0;
        c1 = (uint64_t)q;
        c2 = (uint64_t)(p >> 64) ^ c3 ^ k1;
        c3 = (uint64_t)p;
        k0 += 0x9E3779B97F4A7C15u;
        k1 += 0xBB67AE8584CAA73Bu;
    }
    words[0] = c0, words[1] = c1, words[2] = c2, words[3] = c3;
}

/* Wichura's inverse of the normal distribution function (AS 241): its middle and its tails. */
static inline double middle(double q)
{
    double r = 0.180625 - q * q;
    double top = ((((((2509.0809287301226727 * r + 33430.575583588128105) * r + 67265.770927008700853) * r
        + 45921.953931549871457) * r + 13731.693765509461125) * r + 1971.5909503065514427) * r
        + 133.14166789178437745) * r + 3.387132872796366608;
    double bottom = ((((((5226.495278852545925 * r + 28729.085735721942674) * r + 39307.89580009271061) * r
        + 21213.794301586595867) * r + 5394.1960214247511077) * r + 687.1870074920579083) * r
        + 42.313330701600911252) * r + 1.0;

    return q * top / bottom;
}

static double tail(double p)
{
    double q = p - 0.5, r = sqrt(-log(q < 0.0 ? p : 1.0 - p)), top, bottom;

    if (r <= 5.0) {
        r -= 1.6;
        top = ((((((7.7454501427834140764e-4 * r + 0.0227238449892691845833) * r + 0.24178072517745061177) * r
            + 1.27045825245236838258) * r + 3.64784832476320460504) * r + 5.7694972214606914055) * r
            + 4.6303378461565452959) * r + 1.42343711074968357734;
        bottom = ((((((1.05075007164441684324e-9 * r + 5.475938084995344946e-4) * r + 0.0151986665636164571966) * r
            + 0.14810397642748007459) * r + 0.68976733498510000455) * r + 1.6763848301838038494) * r
            + 2.05319162663775882187) * r + 1.0;
    } else {
        r -= 5.0;
        top = ((((((2.01033439929228813265e-7 * r + 2.71155556874348757815e-5) * r + 0.0012426609473880784386) * r
            + 0.026532189526576123093) * r + 0.29656057182850489123) * r + 1.7848265399172913358) * r
            + 5.4637849111641143699) * r + 6.6579046435011037772;
        bottom = ((((((2.04426310338993978564e-15 * r + 1.4215117583164458887e-7) * r + 1.8463183175100546818e-5) * r
            + 7.868691311456132591e-4) * r + 0.0148753612908506148525) * r + 0.13692988092273580531) * r
            + 0.59983220655588793769) * r + 1.0;
    }
    return q < 0.0 ? -top / bottom : top / bottom;
}

static void draw(const Setting *s, long long first, double numbers[STREAMS][CHUNK])
{
    for (int j = 0; j < STREAMS; ++j) {
        double *row = numbers[j];

        for (int i = 0; i < CHUNK; i += 4) {
            uint64_t words[4];

            philox((uint64_t)(first + i) >> 2, s->channels[j], s->seed, s->keys[j], words);
            for (int w = 0; w < 4; ++w) {
                row[i + w] = ((double)(words[w] >> 12) + 0.5) * (1.0 / 4503599627370496.0);
            }
        }
        for (int i = 0; i < CHUNK; ++i) {
            if (fabs(row[i] - 0.5) > 0.425) {
                row[i] = tail(row[i]);
            }
        }
        for (int i = 0; i < CHUNK; ++i) {
            double q = row[i] - 0.5, z = middle(q);

            row[i] = fabs(q) <= 0.425 ? z : row[i];
        }
    }
}

/* Make the run; return 0, or 1 if the FMU refused a call. Without RECORD only the last row is written. */
static inline __attribute__((always_inline)) int loop(const Car *car, const Setting *s, long long steps, const int parts,
                                                      double *recording)
{
    const double nominal = s->sensor_std * s->sensor_std, prior = s->prior_shape, rho = s->forgetting;
    const double sd = sqrt(s->process_variance), pi = 3.141592653589793;
    double shape = prior, rate0 = prior * nominal, rate1 = rate0, x = s->start_speed, variance = 1.0;
    double v = s->start_speed, held = 0.0, force = 0.0, goal = 0.0, y0 = 0.0, y1 = 0.0, numbers[STREAMS][CHUNK] = {{0.0}};
    controller own;
    controller_outputs out;

    controller_init(&own);
    for (long long k = 0;; ++k) {
        const int i = (int)(k % CHUNK);

        if ((parts & RANDOM) && i == 0) {
            draw(s, k, numbers);
        }
        if ((parts & FMU) && car->get(car->component, &car->output, 1, &v) > WARNING) {
            return 1;
        }
        if (parts & (CONTROL | EXPORTED)) {
            y0 = v + s->sensor_std * numbers[1][i];
            y1 = v + s->sensor_std * numbers[2][i];
            if (k >= s->fault_start && k < s->fault_stop) {
                y0 = held;
            } else {
                held = y0;
            }
            goal = s->offset + s->amplitude * sin(2.0 * pi / s->period * ((double)k * s->step));
        }
        if (parts & EXPORTED) {
            const controller_inputs in = {{y0, y1}, {goal}};

            controller_step(&own, &in, &out);
            force = out.u[0], x = out.x_hat[0];
        }
        if (parts & CONTROL) {
            shape = rho * shape + (1.0 - rho) * prior + 0.5;
            rate0 = rho * rate0 + (1.0 - rho) * prior * nominal + 0.5 * (y0 - x) * (y0 - x);
            rate1 = rho * rate1 + (1.0 - rho) * prior * nominal + 0.5 * (y1 - x) * (y1 - x);
            double p0 = shape / rate0, p1 = shape / rate1;

            variance = 1.0 / (1.0 / variance + p0 + p1);
            x += variance * (p0 * (y0 - x) + p1 * (y1 - x));
            force = (goal - s->a * x) / s->b;
        }
        if ((parts & RECORD) || k == steps) {
            double *row = recording;

            row[0] = v, row[1] = y0, row[2] = y1, row[3] = force, row[4] = x;
            row[5] = (parts & EXPORTED) ? out.precision[0] : shape / rate0;
            row[6] = (parts & EXPORTED) ? out.precision[1] : shape / rate1;
            row[7] = goal + ((parts & (CONTROL | EXPORTED)) ? 0.0 : numbers[0][i] + numbers[1][i] + numbers[2][i]);
            recording += (parts & RECORD) ? COLUMNS : 0;
        }
        if (k == steps) {
            return 0;
        }
        if (parts & FMU) {
            double u[2] = {force, sd * numbers[0][i]};

            if (car->set(car->component, car->inputs, 2, u) > WARNING
                || car->step(car->component, (double)k * s->step, s->step, 1) > WARNING) {
                return 1;
            }
        }
        if (parts & CONTROL) {
            x = s->a * x + s->b * force;
            variance = s->a * s->a * variance + s->process_variance;
        }
    }
}

EXPORT int whole_loop(const Car *car, const Setting *setting, long long steps, double *recording)
{
    return loop(car, setting, steps, RANDOM | FMU | CONTROL | RECORD, recording);
}

EXPORT int own_controller(const Car *car, const Setting *setting, long long steps, double *recording)
{
    return loop(car, setting, steps, RANDOM | FMU | EXPORTED | RECORD, recording);
}

EXPORT int without_recording(const Car *car, const Setting *setting, long long steps, double *recording)
{
    return loop(car, setting, steps, RANDOM | FMU | CONTROL, recording);
}

EXPORT int without_random(const Car *car, const Setting *setting, long long steps, double *recording)
{
    return loop(car, setting, steps, FMU | CONTROL | RECORD, recording);
}

EXPORT int without_fmu(const Car *car, const Setting *setting, long long steps, double *recording)
{
    return loop(car, setting, steps, RANDOM | CONTROL | RECORD, recording);
}

EXPORT int without_control(const Car *car, const Setting *setting, long long steps, double *recording)
{
    return loop(car, setting, steps, RANDOM | FMU | RECORD, recording);
}
