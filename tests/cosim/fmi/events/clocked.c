/* An FMU of FMI 3 with time events and clocks of every kind, which refuses each call that the standard's state machine forbids.
 *
 *   x' = level * u, exact while u is held;  time events at first + k * every: level += 1
 *   a clocked sum w += v and its count at each tick of a clock; other clocks count their ticks and note their time
 *
 * What is not needed is defined from a list by the test (STUBS), so that an importer finds all names.
 */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { OK, WARNING, DISCARD, ERROR };
enum { UNKNOWN, UNCHANGED, CHANGED };
enum { U = 1, X, LEVEL, FIRST, EVERY, MOST, EARLY, LAST, STALE, REFUSE, PERIOD, SHIFT, MODE };
enum { TICK = 20, V, W, TICKS, TIME, EVEN, EVENS };     /* a constant clock, and an output clock that is active at even ticks */
enum { FIXED = 30, FIXED_TICKS, FIXED_TIME };           /* its interval and shift are parameters */
enum { COUNTDOWN = 40, COUNTDOWN_TICKS, COUNTDOWN_TIME }; /* 0.15 s after every fourth tick of the constant one */
enum { CHANGING = 50, CHANGING_TICKS, CHANGING_TIME };  /* after 0.1, 0.2, 0.3, ... s */
enum { TRIGGERED = 60, ON_TRIGGER };

typedef enum { INSTANTIATED, INITIALIZATION, EVENT, STEP, TERMINATED } State;

typedef struct {
    double u, x, first, every, most, early, last, stale, refuse, period, shift, time, v, w, ticked, fixed_time, countdown_time,
        changing_time, countdown;
    int level, events, ticks, evens, fixed_ticks, countdown_ticks, changing_ticks, on_trigger, mode;
    bool touched, tick, even, fixed, counted, changing, changed, returned, basic;
    State state;
    void *environment;
    void (*log)(void *, int, const char *, const char *);
} Plant;

static int refuse(Plant *p, const char *what, ...)
{
    char text[200];
    va_list arguments;
    va_start(arguments, what);
    vsnprintf(text, sizeof text, what, arguments);
    va_end(arguments);
    p->log(p->environment, ERROR, "logStatusError", text);
    return ERROR;
}

#define NEED(condition, what) if (!(condition)) { return refuse(p, "forbidden: %s (state %d, t = %g)", what, p->state, p->time); }

const char *fmi3GetVersion(void) { return "3.0"; }
int fmi3SetDebugLogging(void *c, bool on, size_t n, const char *const names[]) { return OK; }

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path, bool visible, bool logging, bool events,
                                  bool early, const unsigned *required, size_t count, void *environment, void *log, void *update)
{
    Plant *p = calloc(1, sizeof *p);
    p->environment = environment;
    p->log = log;
    p->level = 1;
    p->period = 0.4;
    p->shift = 0.2;
    p->early = p->last = INFINITY;
    p->basic = !events;
    return p;
}

void fmi3FreeInstance(void *c) { free(c); }

int fmi3EnterInitializationMode(void *c, bool d, double tolerance, double t, bool s, double stop)
{
    ((Plant *)c)->state = INITIALIZATION;
    return OK;
}

int fmi3ExitInitializationMode(void *c)
{
    Plant *p = c;
    NEED(p->state == INITIALIZATION, "fmi3ExitInitializationMode");
    p->state = p->basic ? STEP : EVENT;
    return OK;
}

int fmi3Terminate(void *c)
{
    Plant *p = c;
    NEED(p->state == EVENT || p->state == STEP, "fmi3Terminate");
    p->state = TERMINATED;
    p->log(p->environment, WARNING, "logStatusWarning", "terminated");
    return OK;
}

/* Variables */

static double *number(Plant *p, unsigned r)
{
    switch (r) {
    case U: return &p->u;
    case X: return &p->x;
    case FIRST: return &p->first;
    case EVERY: return &p->every;
    case MOST: return &p->most;
    case EARLY: return &p->early;
    case LAST: return &p->last;
    case STALE: return &p->stale;
    case REFUSE: return &p->refuse;
    case PERIOD: return &p->period;
    case SHIFT: return &p->shift;
    case V: return &p->v;
    case W: return &p->w;
    case TIME: return &p->ticked;
    case FIXED_TIME: return &p->fixed_time;
    case COUNTDOWN_TIME: return &p->countdown_time;
    case CHANGING_TIME: return &p->changing_time;
    default: return NULL;
    }
}

static int *whole(Plant *p, unsigned r)
{
    switch (r) {
    case LEVEL: return &p->level;
    case TICKS: return &p->ticks;
    case EVENS: return &p->evens;
    case FIXED_TICKS: return &p->fixed_ticks;
    case COUNTDOWN_TICKS: return &p->countdown_ticks;
    case CHANGING_TICKS: return &p->changing_ticks;
    case ON_TRIGGER: return &p->on_trigger;
    case MODE: return &p->mode;
    default: return NULL;
    }
}

/* Whether the clock of a variable is active, or it has none. */
static bool active(Plant *p, unsigned r)
{
    return r < TICK ? true : r < EVEN ? p->tick : r == EVENS ? p->even : r < COUNTDOWN ? p->fixed
         : r < CHANGING ? p->counted : r < TRIGGERED ? p->changing : false;
}

static int may_read(Plant *p, unsigned r)
{
    NEED(active(p, r) || p->state == INITIALIZATION, "reading a clocked variable while its clock is not active");
    NEED(!(p->state == STEP && p->touched), "reading after setting, without a step between");
    return OK;
}

static int may_set(Plant *p, unsigned r)
{
    const bool input = r == U || r == V || r == MODE;
    NEED(input ? p->state != INSTANTIATED : p->state < EVENT, "setting an input too early, or anything else too late");
    NEED(p->state < EVENT || r != V || p->tick, "setting a clocked input while its clock is not active");
    NEED(p->basic || p->state != STEP || r != MODE, "setting a discrete input outside of event mode");
    p->touched = p->state == STEP;
    return OK;
}

int fmi3SetFloat64(void *c, const unsigned *r, size_t n, const double *v, size_t size)
{
    Plant *p = c;
    for (size_t i = 0; i < n; i++) {
        if (may_set(p, r[i]) || number(p, r[i]) == NULL) { return ERROR; }
        if (p->refuse > 0.0 && r[i] == U && v[i] > p->refuse) { return DISCARD; }
        *number(p, r[i]) = v[i];
    }
    return OK;
}

int fmi3GetFloat64(void *c, const unsigned *r, size_t n, double *v, size_t size)
{
    Plant *p = c;
    for (size_t i = 0; i < n; i++) {
        if (may_read(p, r[i]) || number(p, r[i]) == NULL) { return ERROR; }
        v[i] = r[i] == W && p->tick ? p->w + p->v : *number(p, r[i]); /* what the sum becomes at this tick */
    }
    return OK;
}

int fmi3SetInt32(void *c, const unsigned *r, size_t n, const int32_t *v, size_t size)
{
    Plant *p = c;
    if (may_set(p, r[0]) || r[0] != MODE) { return ERROR; }
    p->mode = v[0];
    return OK;
}

int fmi3GetInt32(void *c, const unsigned *r, size_t n, int32_t *v, size_t size)
{
    Plant *p = c;
    for (size_t i = 0; i < n; i++) {
        if (may_read(p, r[i]) || whole(p, r[i]) == NULL) { return ERROR; }
        v[i] = *whole(p, r[i]);
    }
    return OK;
}

/* Clocks */

int fmi3SetClock(void *c, const unsigned *r, size_t n, const bool *v)
{
    Plant *p = c;
    NEED(p->state == EVENT, "fmi3SetClock");
    for (size_t i = 0; i < n; i++) {
        NEED(v[i], "deactivating a clock");
        if (r[i] == TICK) {
            NEED(fabs(p->time - 0.25 * p->ticks) < 1e-9, "a tick at another time");
            p->tick = true;
            p->ticks += 1;
            p->ticked = p->time;
            p->even = p->ticks % 2 == 0;
            p->evens += p->even;
            p->countdown = p->ticks % 4 == 0 ? p->time + 0.15 : p->countdown;
            p->returned = p->ticks % 4 == 0 ? false : p->returned;
        } else if (r[i] == FIXED) {
            NEED(fabs(p->time - p->shift - p->period * p->fixed_ticks) < 1e-9, "a tick of 'fixed' at another time");
            p->fixed = true;
            p->fixed_ticks += 1;
            p->fixed_time = p->time;
        } else if (r[i] == COUNTDOWN) {
            NEED(fabs(p->time - p->countdown) < 1e-9, "a tick of 'countdown' at another time");
            p->counted = true;
            p->countdown_ticks += 1;
            p->countdown_time = p->time;
        } else if (r[i] == CHANGING) {
            p->changing = p->changed = true;
            p->changing_ticks += 1;
            p->changing_time = p->time;
        } else {
            return refuse(p, "no clock %u is to be ticked", r[i]);
        }
    }
    return OK;
}

int fmi3GetClock(void *c, const unsigned *r, size_t n, bool *v)
{
    Plant *p = c;
    NEED(p->period != 99.0, "fmi3GetClock");
    NEED(p->state == EVENT, "fmi3GetClock");
    for (size_t i = 0; i < n; i++) {
        v[i] = r[i] == EVEN && p->even;
    }
    return OK;
}

int fmi3GetIntervalDecimal(void *c, const unsigned *r, size_t n, double *v, int *qualifier)
{
    Plant *p = c;
    NEED(p->state == INITIALIZATION || p->state == EVENT, "fmi3GetIntervalDecimal");
    if (r[0] == FIXED) {
        v[0] = p->period;
        qualifier[0] = CHANGED;
    } else if (r[0] == CHANGING) {
        v[0] = 0.1 * (p->changing_ticks + 1);
        qualifier[0] = p->state == INITIALIZATION || p->changed ? CHANGED : UNCHANGED;
        p->changed = false;
    } else if (r[0] == COUNTDOWN) {
        qualifier[0] = p->countdown == 0.0 ? UNKNOWN : p->returned ? UNCHANGED : CHANGED;
        v[0] = p->countdown - p->time;
        p->returned = p->countdown > 0.0;
    } else {
        return refuse(p, "the interval of clock %u is constant", r[0]);
    }
    return OK;
}

int fmi3SetIntervalDecimal(void *c, const unsigned *r, size_t n, const double *v)
{
    Plant *p = c;
    NEED(p->state == INITIALIZATION && r[0] == FIXED, "fmi3SetIntervalDecimal");
    p->period = v[0];
    p->shift = 0.0;
    return OK;
}

int fmi3GetShiftDecimal(void *c, const unsigned *r, size_t n, double *v)
{
    Plant *p = c;
    NEED(p->state == INITIALIZATION && r[0] == FIXED, "fmi3GetShiftDecimal");
    v[0] = p->shift;
    return OK;
}

/* Steps and events */

static double next_event(const Plant *p) { return p->every > 0.0 ? p->first + p->events * p->every : INFINITY; }

int fmi3EnterEventMode(void *c)
{
    Plant *p = c;
    NEED(p->state == STEP, "fmi3EnterEventMode");
    p->state = EVENT;
    p->touched = false;
    return OK;
}

int fmi3UpdateDiscreteStates(void *c, bool *again, bool *terminate, bool *nominals, bool *values, bool *defined, double *next)
{
    Plant *p = c;
    NEED(p->state == EVENT, "fmi3UpdateDiscreteStates");
    if (p->time >= next_event(p) - 1e-9) {
        p->level += 1;
        p->events += 1;
    }
    p->w += p->tick ? p->v : 0.0;
    p->tick = p->even = p->fixed = p->counted = p->changing = false;
    *again = *nominals = *values = false;
    *terminate = p->time >= p->last;
    *defined = isfinite(next_event(p)) || p->stale > 0.0;
    *next = p->stale > 0.0 ? 0.5 * p->time : next_event(p);
    return OK;
}

int fmi3EnterStepMode(void *c)
{
    Plant *p = c;
    NEED(p->state == EVENT, "fmi3EnterStepMode");
    p->state = STEP;
    return OK;
}

int fmi3DoStep(void *c, double t, double h, bool keep, bool *event, bool *terminate, bool *early, double *last)
{
    Plant *p = c;
    NEED(p->state == STEP, "fmi3DoStep");
    NEED(fabs(t - p->time) < 1e-9 && h > 0.0, "a step from elsewhere");
    NEED(p->basic || t + h <= next_event(p) + 1e-9, "a step across the next time event");
    NEED(p->basic || p->countdown <= t + 1e-9 || t + h <= p->countdown + 1e-9, "a step across a tick of 'countdown'");
    *event = *terminate = *early = false;
    *last = t + h;
    p->touched = false;
    if (t >= p->early) { /* an event here and now: the standard allows to return at once */
        *event = *early = true;
        *last = t;
        p->early = INFINITY;
        return OK;
    }
    if (p->most > 0.0 && h > p->most) {
        return DISCARD;
    }
    while (p->basic && next_event(p) <= t + h) { /* nobody else handles them */
        p->x += p->level * p->u * (next_event(p) - p->time);
        p->time = next_event(p);
        p->level += 1;
        p->events += 1;
    }
    p->x += p->level * p->u * (t + h - p->time);
    p->time = t + h;
    return OK;
}

/* Saved states: copies of the whole instance, and their bytes */

int fmi3GetFMUState(void *c, void **state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(Plant));
    }
    memcpy(*state, c, sizeof(Plant));
    return OK;
}

int fmi3SetFMUState(void *c, void *state)
{
    Plant *p = c;
    void *environment = p->environment;
    memcpy(c, state, sizeof(Plant));
    p->environment = environment;
    return OK;
}

int fmi3FreeFMUState(void *c, void **state)
{
    free(*state);
    *state = NULL;
    return OK;
}

int fmi3SerializedFMUStateSize(void *c, void *state, size_t *size)
{
    *size = sizeof(Plant);
    return OK;
}

int fmi3SerializeFMUState(void *c, void *state, uint8_t *bytes, size_t size)
{
    memcpy(bytes, state, size);
    return OK;
}

int fmi3DeserializeFMUState(void *c, const uint8_t *bytes, size_t size, void **state)
{
    *state = malloc(size);
    memcpy(*state, bytes, size);
    return OK;
}

#define STUB(name) int name(void) { return ERROR; }
STUBS
