/* Model exchange FMUs of FMI 2 and 3 for tests, with strict checks of modes. The instantiation token names the model.
 *
 *   ball     h' = v, v' = -g, a bounce v -> -e v where h falls to 0; below vmin it comes to rest
 *   heater   T' = (Ta - T + P on) / tau, on below `low`, off above `high`; y = T + Ta (feedthrough), on is an output
 *   pulse    x' = s, where s changes its sign in time events, every `period`, as a running sum
 *   relay    x' = u - sign(x): it chatters once |x| is 0 and |u| < 1
 *   counter  x' = 1; wants completed steps, and event mode once x >= 1, where x -= 1 and n += 1
 *   gate     no states: y = 2 d + u, d a discrete input that can be set in event mode only; n counts event modes
 *   endless  a time event at 0.5 whose iteration does not end
 *   ends     a time event at 0.4 that ends the simulation
 *   nan      x' = -1 + 0 sqrt(x), x(0) = 0.35
 *   fails    x' = 1, an error from t = 0.35 on, or another `status`
 *   past     announces time events in the past, from t = 0.2 on
 *   lag      x' = u - x for arrays of three, in FMI 3 only; y = x; its nominal values are 0, 1e-4 and none
 *   clock    a time event every second; no states, no indicators; n counts them
 *   edge     x' = u; n = (x > 0), which changes in events alone
 *   fine     x' = -s, s changes its sign where |x| = w: an event each 2 w seconds
 *   wild     x' = -1 until x <= 0.1; where x < 0.05, by `how`: 0 indicators are discarded, 1 derivatives, 2 indicators are NaN
 *   stack    x' = 1; three time events at `at`, one after the other, counted by n
 *   blank    says OK and does not write, by `what`: 1 outputs, 2 derivatives, 3 states, 4 event indicators; 5: its state is NaN,
 *            6: so is the time of its next event, 7: it is minus infinity,
 *            8: its state jumps to infinity at 0.5, 9: the output n, a whole number, is not written;
 *            writes too much: 11 outputs, 12 derivatives, 13 states, 14 event indicators
 *   count    has two states where its description has one (FMI 3)
 *   slide    a mass on a belt, held by a spring: it sticks until x = Fs and slips until its speed v is that of the belt
 *   scale    x' = -x; at 0.5 x becomes 1e-6 and, unless `quiet`, says that its nominal value is that, too
 *   quits    x' = 1; ends the simulation: after a step with x >= 0.35, or (`now` = 1) at once
 *   pol      the oscillator of van der Pol
 *   alarm    no states; n counts the zeros of sin t, `when` is that of the last one
 *   tuned    x' = -k x, k a tunable parameter, in FMUs that remember nothing else
 *   typed    x' = u + m, y = k x + s; inputs, parameters and outputs (which show the inputs) of all types
 */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"
#include "fmi3Functions.h"

enum { BALL, HEATER, PULSE, RELAY, COUNTER, GATE, ENDLESS, ENDS, NOT_A_NUMBER, FAILS, PAST, CLOCK, LAG, EDGE, FINE, WILD, STACK,
       BLANK, COUNT, SLIDE, SCALE, QUITS, POL, ALARM, TUNED, TYPED, MODELS };
static const char *TOKENS[MODELS] = {"ball", "heater", "pulse", "relay", "counter", "gate", "endless", "ends", "nan", "fails",
                                     "past", "clock", "lag", "edge", "fine", "wild", "stack", "blank", "count", "slide", "scale",
                                     "quits", "pol", "alarm", "tuned", "typed"};
enum { START, INIT, EVENT, CONTINUOUS };
/* Value references: 0, 1 states; 2, 3 derivatives; 4, 5 inputs; 6 n or on; 7 y; 10.. parameters. Of `typed`: 14 to 28 inputs and
 * tunable parameters, 34 to 48 the outputs that show them, 20 further on. */
enum { NV = 64 };
/* The type of each: Float64, Float32, (U)Int8 ... 64 as letters, Boolean, an enumeration. The array of two has two places. */
static const char KINDS[] = "fabcdijlmBEDiii";

typedef struct {
    int model, mode, flag;
    double t, event, began, v[NV];
} State;

typedef struct {
    State s;
    fmi2CallbackLogger log2;
    fmi3LogMessageCallback log3;
    void *environment;
} Instance;

static int states(int model) {
    switch (model) {
    case LAG: return 3;
    case BALL: case SLIDE: case POL: return 2;
    case GATE: case CLOCK: case ALARM: return 0;
    default: return 1;
    }
}
static int indicators(int model) {
    switch (model) {
    case BALL: case RELAY: case EDGE: case WILD: case BLANK: case ALARM: return 1;
    case HEATER: case FINE: case SLIDE: return 2;
    default: return 0;
    }
}

static int say(Instance *m, int status, const char *text) {
    if (m->log2) m->log2(m->environment, "test", (fmi2Status)status, "logStatusError", "%s", text);
    if (m->log3) m->log3(m->environment, (fmi3Status)status, "logStatusError", text);
    return status;
}

static Instance *make(const char *token) {
    for (int i = 0; i < MODELS; i++)
        if (strcmp(token, TOKENS[i]) == 0) {
            Instance *m = calloc(1, sizeof(Instance));
            double *v = m->s.v;
            m->s.model = i;
            m->s.event = INFINITY;
            if (i == BALL) v[0] = 1, v[10] = 9.81, v[11] = 0.7, v[12] = 0.1;
            if (i == HEATER) v[0] = 15, v[4] = 10, v[10] = 19, v[11] = 21, v[12] = 20, v[13] = 5, v[6] = 1;
            if (i == PULSE) v[10] = 0.1, v[6] = 1;
            if (i == RELAY) v[0] = 0.25, v[6] = 1;
            if (i == NOT_A_NUMBER) v[0] = 0.35;
            if (i == FAILS) v[10] = 3;
            if (i == PAST) m->s.event = 0.2;
            if (i == CLOCK) m->s.event = 1;
            if (i == ENDLESS) m->s.event = 0.5;
            if (i == ENDS) m->s.event = 0.4;
            if (i == EDGE) v[4] = 1;
            if (i == FINE) v[10] = 1e-7, v[6] = 1;
            if (i == WILD) v[0] = 1, v[6] = 1;
            if (i == STACK) v[10] = 0.5;
            if (i == SLIDE) v[10] = 0.2, v[11] = 0.6, v[12] = 0.4;
            if (i == SCALE) v[0] = 1, m->s.event = 0.5;
            if (i == POL) v[0] = 2, v[10] = 1000;
            if (i == TUNED) v[0] = v[25] = 1;
            if (i == TYPED) v[24] = v[25] = 1;
            return m;
        }
    return NULL;
}

static int derivatives(Instance *m, double *dx) {
    State *s = &m->s;
    double *v = s->v;
    switch (s->model) {
    case BALL: dx[0] = s->flag ? 0 : v[1]; dx[1] = s->flag ? 0 : -v[10]; break;
    case HEATER: dx[0] = (v[4] - v[0] + v[12] * v[6]) / v[13]; break;
    case PULSE: dx[0] = v[6]; break;
    case RELAY: dx[0] = v[4] - v[6]; break;
    case NOT_A_NUMBER: dx[0] = -1 + 0 * sqrt(v[0]); break;
    case LAG: for (int i = 0; i < 3; i++) dx[i] = v[4 + i] - v[i]; break;
    case FAILS: if (s->t >= 0.35) return say(m, (int)v[10], "the valve is stuck"); dx[0] = 1; break;
    case EDGE: dx[0] = v[4]; break;
    case FINE: dx[0] = -v[6]; break;
    case WILD: if (v[10] == 1 && v[0] < 0.05) return say(m, 2, "too far"); dx[0] = -v[6]; break;
    case BLANK: if (v[10] != 2) dx[0] = 1; if (v[10] == 12) dx[1] = 1; break;
    case SLIDE: dx[0] = v[1]; dx[1] = s->flag ? 0 : v[12] - v[0]; break;
    case SCALE: dx[0] = -v[0]; break;
    case TUNED: dx[0] = -v[25] * v[0]; break;
    case POL: dx[0] = v[1]; dx[1] = v[10] * (1 - v[0] * v[0]) * v[1] - v[0]; break;
    case TYPED: dx[0] = v[4] + v[26]; break;
    default: if (states(s->model)) dx[0] = 1;
    }
    return 0;
}

static int reached(Instance *m, double *z) {
    double *v = m->s.v;
    switch (m->s.model) {
    case BALL: z[0] = m->s.flag ? 1 : v[0]; break;
    case HEATER: z[0] = v[0] - v[10]; z[1] = v[0] - v[11]; break;
    case RELAY: case EDGE: z[0] = v[0]; break;
    case ALARM: z[0] = sin(m->s.t); break;
    case FINE: z[0] = v[0] - v[10]; z[1] = v[0] + v[10]; break;
    case WILD:
        if (v[10] == 0 && v[0] < 0.05) return say(m, 2, "too far");
        z[0] = v[10] == 2 && v[0] < 0.05 ? NAN : v[0] - 0.1;
        break;
    case BLANK: if (v[10] != 4) z[0] = 1; if (v[10] == 14) z[1] = 1; break;
    case SLIDE: z[0] = m->s.flag ? 1 : v[10] - v[1]; z[1] = m->s.flag ? v[11] - v[0] : 1; break;
    }
    return 0;
}

static int get(Instance *m, unsigned reference, double *value) {
    State *s = &m->s;
    double dx[2] = {0, 0};
    if (reference == 2 || reference == 3) {
        int status = derivatives(m, dx);
        *value = dx[reference - 2];
        return status;
    }
    if (reference >= NV) return say(m, 3, "no such variable");
    if (s->model == TYPED && reference == 7) return *value = s->v[25] * s->v[0] + s->v[14], 0;
    if (s->model == TYPED && reference >= 34) return *value = s->v[reference - 20], 0;
    *value = reference != 7 ? s->v[reference] : s->model == GATE ? 2 * s->v[5] + s->v[4] : s->v[0] + s->v[4];
    return 0;
}

static int set(Instance *m, unsigned reference, double value) {
    int mode = m->s.mode;
    if (reference >= NV) return say(m, 3, "no such variable");
    if (reference == 5 && mode == CONTINUOUS) return say(m, 3, "a discrete input changes in event mode only");
    if ((m->s.model == TYPED || m->s.model == TUNED) && reference != 4 && reference != 14 && mode == CONTINUOUS)
        return say(m, 3, "discrete inputs and tunable parameters change in event mode only");
    if (m->s.model != TYPED && m->s.model != TUNED && reference >= 10 && mode > INIT) return say(m, 3, "parameters are fixed");
    m->s.v[reference] = value;
    return 0;
}

static int update(Instance *m, int *needed, int *terminate, int *changed, int *defined, double *next) {
    State *s = &m->s;
    double *v = s->v;
    if (s->mode != EVENT) return say(m, 3, "not in event mode");
    *needed = *terminate = *changed = 0;
    switch (s->model) {
    case BALL:
        if (v[0] <= 0 && v[1] < 0) {
            v[0] = 0; v[1] *= -v[11]; *changed = 1;
            if (v[1] < v[12]) v[1] = 0, s->flag = 1;
        }
        break;
    case HEATER: if (v[0] >= v[11]) v[6] = 0; if (v[0] <= v[10]) v[6] = 1; break;
    case RELAY: v[6] = v[0] > 0 ? 1 : -1; break;
    case PULSE:
        if (s->event == INFINITY) s->event = v[10];
        else if (s->t >= s->event) { v[6] = -v[6]; s->event += v[10]; }
        break;
    case COUNTER: if (v[0] >= 1) v[0] -= 1, v[6] += 1, *changed = 1; break;
    case GATE: v[6] += 1; break;
    case ENDLESS: if (s->t >= 0.5) *needed = 1; break;
    case ENDS: if (s->t >= 0.4) { say(m, 0, "the tank is empty"); *terminate = 1; } break;
    case EDGE: v[6] = v[0] > 0; break;
    case FINE: if (v[0] <= -v[10]) v[6] = -1; if (v[0] >= v[10]) v[6] = 1; break;
    case WILD: if (v[0] <= 0.1) v[6] = 0; break;
    case STACK:
        if (!s->flag) s->flag = 1, s->event = v[10];
        else if (s->t >= s->event && (v[6] += 1) >= 3) s->event = INFINITY;
        break;
    case SLIDE:
        if (s->flag && v[0] >= v[11]) s->flag = 0;
        else if (!s->flag && v[1] >= v[10] && v[0] < v[11]) s->flag = 1, v[1] = v[10], *changed = 1;
        break;
    case SCALE: if (s->t >= s->event) v[0] = 1e-6, *changed = 1, s->flag = 1, s->event = INFINITY; break;
    case ALARM:
        if ((sin(s->t) > 0) != s->flag) s->flag = !s->flag, v[6] += 1, v[8] = s->t;
        break;
    case QUITS: *terminate = v[10] == 1; break;
    case CLOCK: if (s->t >= s->event) v[6] += 1, s->event += 1; break;
    }
    if (s->model == BLANK && v[10] >= 6) s->event = v[10] == 6 ? NAN : v[10] == 7 ? -INFINITY : s->t < 0.5 ? 0.5 : INFINITY;
    *defined = !(s->event == INFINITY);
    *next = s->event;
    return 0;
}

static int into(Instance *m, int from, int to) {
    if (m->s.mode != from) return say(m, 3, "wrong mode");
    m->s.mode = to;
    if (to == EVENT) m->s.began = m->s.t;
    return 0;
}

static int now(Instance *m, double t) {
    if (m->s.mode != CONTINUOUS) return say(m, 3, "time is set in continuous-time mode only");
    if (t < m->s.began) return say(m, 3, "time goes back before the last event");
    m->s.t = t;
    return 0;
}

static int write_states(Instance *m, const double *x, size_t n) {
    if (m->s.mode != CONTINUOUS || (int)n != states(m->s.model)) return say(m, 3, "wrong mode or number of states");
    memcpy(m->s.v, x, n * sizeof(double));
    return 0;
}

static int completed(Instance *m, int *enter, int *terminate) {
    if (m->s.mode != CONTINUOUS) return say(m, 3, "not in continuous-time mode");
    *enter = m->s.model == COUNTER && m->s.v[0] >= 1;
    *terminate = m->s.model == QUITS && m->s.v[0] >= 0.35;
    return 0;
}

static int read_states(Instance *m, double *x, size_t n) {
    if (m->s.model != BLANK || m->s.v[10] != 3) memcpy(x, m->s.v, n * sizeof(double));
    if (m->s.model == BLANK && m->s.v[10] == 5) x[0] = NAN;
    if (m->s.model == BLANK && m->s.v[10] == 13) x[n] = 1;
    if (m->s.model == BLANK && m->s.v[10] == 8 && m->s.t >= 0.5) x[0] = INFINITY;
    return 0;
}

static int nominals(Instance *m, double *x, size_t n) {
    if (m->s.model == SCALE && m->s.flag && m->s.v[10] == 2) return say(m, 3, "no nominal values");
    for (size_t i = 0; i < n && m->s.model == LAG; i++) x[i] = i == 1 ? 1e-4 : i == 2 ? NAN : 0;
    for (size_t i = 0; i < n && m->s.model != LAG; i++) x[i] = m->s.model == SCALE && m->s.flag && !m->s.v[10] ? 1e-6 : 1;
    return 0;
}

static int silent(Instance *m, unsigned reference) {
    return m->s.model == BLANK && (m->s.v[10] == 1 || (m->s.v[10] == 9 && reference == 39));
}

/* How many places a variable has, if it is of this type; else 0. */
static int places(Instance *m, unsigned reference, char kind) {
    unsigned i = reference - (reference >= 34 ? 34 : 14);
    if (m->s.model == BLANK && reference == 39) return kind == 'i';
    if (m->s.model != TYPED || i >= sizeof KINDS - 1) return kind == 'D';
    return KINDS[i] != kind ? 0 : reference == 27 || reference == 47 ? 2 : 1;
}

#define M ((Instance *)c)
#define GET(name, type, kinds, given) { \
    size_t j = 0; \
    for (size_t i = 0; i < n; i++) { \
        int size = 0; \
        for (const char *kind = kinds; *kind && !size; kind++) size = places(M, r[i], *kind); \
        if (!size) return say(M, 3, #name ": a variable of another type"); \
        for (int e = 0; e < size; e++) { \
            double value = NAN; \
            int status = get(M, r[i] + e, &value); \
            if (status) return status; \
            if (j < given && !silent(M, r[i])) x[j] = (type)value; \
            j++; \
        } \
    } \
    if (M->s.model == BLANK && M->s.v[10] == 11 && j) x[j] = 1; \
    return j == given ? 0 : say(M, 3, #name ": a number of values that does not fit"); \
}
#define SET(name, kinds, given) { \
    size_t j = 0; \
    for (size_t i = 0; i < n; i++) { \
        int size = 0; \
        for (const char *kind = kinds; *kind && !size; kind++) size = places(M, r[i], *kind); \
        if (!size) return say(M, 3, #name ": a variable of another type"); \
        for (int e = 0; e < size; e++, j++) { \
            int status = j < given ? set(M, r[i] + e, (double)x[j]) : 3; \
            if (status) return status; \
        } \
    } \
    return j == given ? 0 : say(M, 3, #name ": a number of values that does not fit"); \
}
#define GET2(name, type, kinds) fmi2Status name(fmi2Component c, const fmi2ValueReference r[], size_t n, type x[]) GET(name, type, kinds, n)
#define SET2(name, type, kinds) fmi2Status name(fmi2Component c, const fmi2ValueReference r[], size_t n, const type x[]) SET(name, kinds, n)
#define GET3(name, type, kinds) \
    fmi3Status name(fmi3Instance c, const fmi3ValueReference r[], size_t n, type x[], size_t nx) GET(name, type, kinds, nx)
#define SET3(name, type, kinds) \
    fmi3Status name(fmi3Instance c, const fmi3ValueReference r[], size_t n, const type x[], size_t nx) SET(name, kinds, nx)
/* FMI 2 */
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String where, const fmi2CallbackFunctions *f,
                              fmi2Boolean visible, fmi2Boolean log) {
    Instance *m = type == fmi2ModelExchange ? make(token) : NULL;
    if (m) m->log2 = f->logger, m->environment = f->componentEnvironment;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real t, fmi2Real start, fmi2Boolean sd, fmi2Real stop) { M->s.t = start; return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return into(M, START, INIT); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return into(M, INIT, EVENT); }
fmi2Status fmi2Terminate(fmi2Component c) { return say(M, 0, "terminated"); }
fmi2Status fmi2Reset(fmi2Component c) {
    Instance *m = make(TOKENS[M->s.model]);
    M->s = m->s;
    free(m);
    return fmi2OK;
}
GET2(fmi2GetReal, fmi2Real, "D") SET2(fmi2SetReal, fmi2Real, "D")
GET2(fmi2GetInteger, fmi2Integer, "iE") SET2(fmi2SetInteger, fmi2Integer, "iE")
GET2(fmi2GetBoolean, fmi2Boolean, "B") SET2(fmi2SetBoolean, fmi2Boolean, "B")
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String x[]) { return n ? fmi2Error : fmi2OK; }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String x[]) { return n ? fmi2Error : fmi2OK; }
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) {
    if (!*s) *s = malloc(sizeof(State));
    memcpy(*s, &M->s, sizeof(State));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { memcpy(&M->s, s, sizeof(State)); return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { free(*s); *s = NULL; return fmi2OK; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) { *n = sizeof(State); return fmi2OK; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n) { memcpy(b, s, n); return fmi2OK; }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s) {
    if (!*s) *s = malloc(sizeof(State));
    memcpy(*s, b, n);
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu, const fmi2ValueReference k[],
                                        size_t nk, const fmi2Real dk[], fmi2Real du[]) { return fmi2Error; }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return into(M, CONTINUOUS, EVENT); }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return into(M, EVENT, CONTINUOUS); }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *e) {
    e->nominalsOfContinuousStatesChanged = M->s.model == SCALE && !M->s.v[10];
    return update(M, &e->newDiscreteStatesNeeded, &e->terminateSimulation, &e->valuesOfContinuousStatesChanged,
                  &e->nextEventTimeDefined, &e->nextEventTime);
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no, fmi2Boolean *enter, fmi2Boolean *end) { return completed(M, enter, end); }
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { return now(M, t); }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { return write_states(M, x, n); }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real x[], size_t n) { return derivatives(M, x); }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { return reached(M, z); }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { return read_states(M, x, n); }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { return nominals(M, x, n); }

/* FMI 3: what a model exchange FMU needs; the rest are symbols that nobody calls. */
const char * fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String where, fmi3Boolean visible, fmi3Boolean on,
                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    Instance *m = make(token);
    if (m) m->log3 = log, m->environment = environment;
    return m;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String names[]) { return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 t, fmi3Float64 start, fmi3Boolean sd, fmi3Float64 stop) { M->s.t = start; return into(M, START, INIT); }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return into(M, INIT, EVENT); }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi2Terminate(c); }
fmi3Status fmi3Reset(fmi3Instance c) { return fmi2Reset(c); }
static GET3(get_numbers, fmi3Float64, "D")
static SET3(set_numbers, fmi3Float64, "D")
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 x[], size_t nx) {
    if (M->s.model != LAG) return get_numbers(c, r, n, x, nx);
    if (nx != 3 * n) return say(M, 3, "arrays of three");
    for (size_t i = 0; i < n; i++)
        if (r[i] == 2) derivatives(M, x + 3 * i);
        else memcpy(x + 3 * i, M->s.v + (r[i] == 4 ? 4 : 0), 3 * sizeof(double));
    return fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 x[], size_t nx) {
    if (M->s.model != LAG) return set_numbers(c, r, n, x, nx);
    if (nx != 3 * n) return say(M, 3, "arrays of three");
    for (size_t i = 0; i < n; i++) memcpy(M->s.v + r[i], x + 3 * i, 3 * sizeof(double));
    return fmi3OK;
}
GET3(fmi3GetFloat32, fmi3Float32, "f") SET3(fmi3SetFloat32, fmi3Float32, "f")
GET3(fmi3GetInt8, fmi3Int8, "a") SET3(fmi3SetInt8, fmi3Int8, "a")
GET3(fmi3GetUInt8, fmi3UInt8, "b") SET3(fmi3SetUInt8, fmi3UInt8, "b")
GET3(fmi3GetInt16, fmi3Int16, "c") SET3(fmi3SetInt16, fmi3Int16, "c")
GET3(fmi3GetUInt16, fmi3UInt16, "d") SET3(fmi3SetUInt16, fmi3UInt16, "d")
GET3(fmi3GetInt32, fmi3Int32, "i") SET3(fmi3SetInt32, fmi3Int32, "i")
GET3(fmi3GetUInt32, fmi3UInt32, "j") SET3(fmi3SetUInt32, fmi3UInt32, "j")
GET3(fmi3GetInt64, fmi3Int64, "lE") SET3(fmi3SetInt64, fmi3Int64, "lE")
GET3(fmi3GetUInt64, fmi3UInt64, "m") SET3(fmi3SetUInt64, fmi3UInt64, "m")
GET3(fmi3GetBoolean, fmi3Boolean, "B") SET3(fmi3SetBoolean, fmi3Boolean, "B")
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) { return fmi2GetFMUstate(c, s); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { return fmi2SetFMUstate(c, s); }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { return fmi2FreeFMUstate(c, s); }
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState s, size_t *n) { *n = sizeof(State); return fmi3OK; }
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState s, fmi3Byte b[], size_t n) { memcpy(b, s, n); return fmi3OK; }
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte b[], size_t n, fmi3FMUState *s) { return fmi2DeSerializeFMUstate(c, (const fmi2Byte *)b, n, s); }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { return into(M, CONTINUOUS, EVENT); }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return into(M, EVENT, CONTINUOUS); }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *needed, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next) {
    int n, e, v, d, status = update(M, &n, &e, &v, &d, next);
    *needed = n, *terminate = e, *nominals = M->s.model == SCALE && !M->s.v[10], *values = v, *defined = d;
    return status;
}
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no, fmi3Boolean *enter, fmi3Boolean *end) {
    int a, b, status = completed(M, &a, &b);
    *enter = a, *end = b;
    return status;
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) { return now(M, t); }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) { return write_states(M, x, n); }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 x[], size_t n) { return derivatives(M, x); }
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) { return reached(M, z); }
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return fmi2GetContinuousStates(c, x, n); }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return fmi2GetNominalsOfContinuousStates(c, x, n); }
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { *n = indicators(M->s.model); return fmi3OK; }
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { *n = states(M->s.model) + (M->s.model == COUNT); return fmi3OK; }
