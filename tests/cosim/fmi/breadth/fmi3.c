/* An FMU of FMI 3 with arrays whose size is a structural parameter, ports of every type, a tunable parameter and events.
 *
 *   x' = k * level * K u, exact while u is held;  y = x;  total = sum of x
 *   an event at each multiple of 0.25 s: count += 1, and level takes the value of its input `next`
 *
 * What is not needed is defined from a list by the test (STUBS), so that an importer finds all names.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MOST 8
#define EVERY 0.25

enum { OK, WARNING, DISCARD, ERROR };
enum { N = 1, U, K, X0, Y, GAIN, TOTAL, STALL, COUNT, NEXT, BYTE_IN, BYTE_OUT, LONG_IN, LONG_OUT, FLAG_IN, FLAG_OUT, MODE_IN,
       MODE_OUT, SINGLE_IN, SINGLE_OUT, WORD_IN, WORD_OUT, LABEL, LENGTH, NUMBERS };

typedef struct {
    uint64_t n;
    double u[MOST], K[MOST * MOST], x[MOST], gain, stall, numbers[2];
    int level, count, next, settling, structured;
    double event;
    int8_t byte;
    int64_t wide, mode;
    bool flag, event_mode, early, configuring, started, told;
    float single;
    uint16_t word;
    char label[32];
} Plant;

static void identity(Plant *p)
{
    memset(p->K, 0, sizeof p->K);
    for (size_t i = 0; i < p->n; i++) {
        p->K[i * p->n + i] = 1.0;
    }
}

const char *fmi3GetVersion(void) { return "3.0"; }
int fmi3SetDebugLogging(void *c, bool on, size_t n, const char *const names[]) { return OK; }

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path, bool visible, bool logging, bool events,
                                  bool early, const unsigned *required, size_t count, void *environment, void *log, void *update)
{
    Plant *p = calloc(1, sizeof *p);
    p->n = 2;
    p->gain = 1.0;
    p->level = 1;
    p->next = 1;
    p->mode = 1;
    p->event = EVERY;
    p->event_mode = events;
    p->early = early;
    strcpy(p->label, "none");
    p->told = strstr(name, "told") != NULL;
    for (int i = 0; i < MOST && strstr(name, "moved"); i++) {
        p->u[i] = i + 1.0;
    }
    identity(p);
    return p;
}

void fmi3FreeInstance(void *c) { free(c); }
int fmi3EnterConfigurationMode(void *c) { ((Plant *)c)->configuring = true; return OK; }
int fmi3ExitConfigurationMode(void *c) { ((Plant *)c)->configuring = false; identity(c); return OK; }
int fmi3EnterInitializationMode(void *c, bool d, double tolerance, double t, bool s, double stop)
{
    Plant *p = c;
    for (int i = 0; i < MOST && p->told; i++) {
        p->u[i] = d ? tolerance : -1.0;
    }
    return OK;
}

int fmi3ExitInitializationMode(void *c) { ((Plant *)c)->started = true; ((Plant *)c)->settling = ((Plant *)c)->event_mode; return OK; }
int fmi3Terminate(void *c) { return OK; }

int fmi3SetUInt64(void *c, const unsigned *r, size_t n, const uint64_t *v, size_t size)
{
    Plant *p = c;
    if (n != 1 || r[0] != N || size != 1 || !p->configuring || v[0] > MOST) {
        return ERROR;
    }
    p->n = v[0];
    return OK;
}

int fmi3GetUInt64(void *c, const unsigned *r, size_t n, uint64_t *v, size_t size)
{
    v[0] = ((Plant *)c)->n;
    return r[0] == N ? OK : ERROR;
}

static double *doubles(Plant *p, unsigned r, size_t *size)
{
    *size = r == K ? p->n * p->n : r == GAIN || r == STALL ? 1 : r == NUMBERS ? 2 : p->n;
    return r == U ? p->u : r == K ? p->K : r == X0 || r == Y ? p->x : r == GAIN ? &p->gain : r == STALL ? &p->stall
         : r == NUMBERS ? p->numbers : NULL;
}

int fmi3SetFloat64(void *c, const unsigned *r, size_t n, const double *v, size_t size)
{
    Plant *p = c;
    const double *end = v + size;
    for (size_t i = 0; i < n; i++) {
        size_t count;
        double *place = doubles(p, r[i], &count);
        if (place == NULL || r[i] == Y || v + count > end || p->configuring || (r[i] == GAIN && p->started && p->event_mode && !p->settling)) {
            return ERROR;
        }
        memcpy(place, v, count * sizeof *v);
        v += count;
    }
    return v == end ? OK : ERROR;
}

int fmi3GetFloat64(void *c, const unsigned *r, size_t n, double *v, size_t size)
{
    Plant *p = c;
    const double *end = v + size;
    for (size_t i = 0; i < n; i++) {
        size_t count = 1;
        double total = 0.0;
        const double *place = r[i] == TOTAL ? &total : doubles(p, r[i], &count);
        for (size_t j = 0; j < p->n; j++) {
            total += p->x[j];
        }
        if (place == NULL || v + count > end) {
            return ERROR;
        }
        memcpy(v, place, count * sizeof *v);
        v += count;
    }
    return v == end ? OK : ERROR;
}

/* Ports of one type: what goes in at one reference comes out at the next. */
#define TYPE(Name, type, in, out, member) \
    int fmi3Set##Name(void *c, const unsigned *r, size_t n, const type *v, size_t size) \
    { \
        if (n != 1 || size != 1 || r[0] != (in)) { return ERROR; } \
        ((Plant *)c)->member = v[0]; \
        return OK; \
    } \
    int fmi3Get##Name(void *c, const unsigned *r, size_t n, type *v, size_t size) \
    { \
        if (n != 1 || size != 1 || (r[0] != (in) && r[0] != (out))) { return ERROR; } \
        v[0] = ((Plant *)c)->member; \
        return OK; \
    }

TYPE(Int8, int8_t, BYTE_IN, BYTE_OUT, byte)
TYPE(UInt16, uint16_t, WORD_IN, WORD_OUT, word)
TYPE(Boolean, bool, FLAG_IN, FLAG_OUT, flag)
TYPE(Float32, float, SINGLE_IN, SINGLE_OUT, single)

int fmi3SetInt64(void *c, const unsigned *r, size_t n, const int64_t *v, size_t size)
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] != LONG_IN && r[i] != MODE_IN) { return ERROR; }
        *(r[i] == LONG_IN ? &((Plant *)c)->wide : &((Plant *)c)->mode) = v[i];
    }
    return OK;
}

int fmi3GetInt64(void *c, const unsigned *r, size_t n, int64_t *v, size_t size)
{
    for (size_t i = 0; i < n; i++) {
        v[i] = r[i] == LONG_OUT ? 2 * ((Plant *)c)->wide : ((Plant *)c)->mode;
    }
    return OK;
}

int fmi3SetInt32(void *c, const unsigned *r, size_t n, const int32_t *v, size_t size)
{
    Plant *p = c;
    if (n != 1 || r[0] != NEXT || (p->started && p->event_mode && !p->settling)) { return ERROR; }
    p->next = v[0];
    return OK;
}

int fmi3GetInt32(void *c, const unsigned *r, size_t n, int32_t *v, size_t size)
{
    Plant *p = c;
    for (size_t i = 0; i < n; i++) {
        v[i] = r[i] == COUNT ? p->count : r[i] == LENGTH ? (int32_t)strlen(p->label) : p->next;
    }
    return OK;
}

int fmi3SetString(void *c, const unsigned *r, size_t n, const char *const *v, size_t size)
{
    strncpy(((Plant *)c)->label, v[0], 31);
    return OK;
}

/* Saved states: copies of the whole instance */

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
    memcpy(c, state, sizeof(Plant));
    return OK;
}

int fmi3FreeFMUState(void *c, void **state)
{
    free(*state);
    *state = NULL;
    return OK;
}

/* Steps and events */

static void happen(Plant *p)
{
    p->count += 1;
    p->level = p->next;
    p->event += EVERY;
}

int fmi3EnterEventMode(void *c)
{
    ((Plant *)c)->settling = 1;
    return ((Plant *)c)->event_mode ? OK : ERROR;
}

int fmi3UpdateDiscreteStates(void *c, bool *again, bool *terminate, bool *nominals, bool *values, bool *defined, double *next)
{
    Plant *p = c;
    if (!p->settling) {
        return ERROR;
    }
    *again = p->settling == 1; /* two rounds, always */
    p->settling = 2;
    *terminate = *nominals = *values = *defined = false;
    return OK;
}

int fmi3EnterStepMode(void *c)
{
    Plant *p = c;
    if (p->settling != 2) {
        return ERROR;
    }
    p->settling = 0;
    return OK;
}

int fmi3DoStep(void *c, double t, double h, bool keep, bool *event, bool *terminate, bool *early, double *last)
{
    Plant *p = c;
    const double end = t + h;
    double now = t;

    *event = *terminate = *early = false;
    if (p->settling) {
        return ERROR;
    }
    if (p->stall > 0.0 && t >= p->stall) { /* comes nowhere, or hardly anywhere */
        *early = true;
        *last = p->stall < 0.5 ? t : t + 1e-13;
        return OK;
    }
    for (;;) {
        const bool comes = p->event <= end + 1e-12;
        const double to = comes ? p->event : end;
        for (size_t i = 0; i < p->n; i++) {
            for (size_t j = 0; j < p->n; j++) {
                p->x[i] += (to - now) * p->gain * p->level * p->K[i * p->n + j] * p->u[j];
            }
        }
        now = to;
        if (!comes) {
            break;
        }
        happen(p);
        if (p->event_mode) {
            *event = true;
            *early = p->early && now < end - 1e-12;
        }
        if (*early || now >= end) {
            break;
        }
    }
    *last = now;
    return OK;
}

#define STUB(name) int name(void) { return ERROR; }
STUBS
