/* An FMU of FMI 2 that discards steps which are too long, with ports of every type.
 *
 *   x' = k u;  what goes in as Integer, Boolean or enumeration comes out
 *   a step above `most` is discarded: after `reach` of it is done
 */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

enum { OK, WARNING, DISCARD, ERROR };
enum { U, K, X, MOST, REACH, STEPS, COUNT_IN, COUNT_OUT, FLAG_IN, FLAG_OUT, MODE_IN, MODE_OUT, LIE, END };

typedef struct {
    double r[20], last;
    int i[20], initializing;
} Plant;

const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const names[]) { return OK; }

void *fmi2Instantiate(const char *name, int type, const char *token, const char *path, const void *callbacks, int v, int l)
{
    Plant *p = calloc(1, sizeof *p);
    p->r[K] = 1.0;
    p->r[MOST] = p->r[END] = 1e9;
    p->i[MODE_IN] = 1;
    return p;
}

void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int d, double tolerance, double t, int s, double stop) { return OK; }
int fmi2EnterInitializationMode(void *c) { ((Plant *)c)->initializing = 1; return OK; }
int fmi2ExitInitializationMode(void *c) { return OK; }
int fmi2Terminate(void *c) { return OK; }
int fmi2Reset(void *c) { return OK; }

#define VALUES(Name, type, member) \
    int fmi2Set##Name(void *c, const unsigned *r, size_t n, const type *v) \
    { \
        for (size_t i = 0; i < n; i++) { \
            if (r[i] == U && !((Plant *)c)->initializing) { return ERROR; } /* an input, too early */ \
            ((Plant *)c)->member[r[i]] = v[i]; \
        } \
        return OK; \
    } \
    int fmi2Get##Name(void *c, const unsigned *r, size_t n, type *v) \
    { \
        for (size_t i = 0; i < n; i++) { v[i] = ((Plant *)c)->member[r[i]]; } \
        return OK; \
    }

VALUES(Real, double, r)

int fmi2SetInteger(void *c, const unsigned *r, size_t n, const int *v)
{
    for (size_t i = 0; i < n; i++) { ((Plant *)c)->i[r[i]] = v[i]; }
    return OK;
}

int fmi2GetInteger(void *c, const unsigned *r, size_t n, int *v)
{
    if (((Plant *)c)->r[LIE] == -1.0) { return OK; } /* and writes nothing */
    if (((Plant *)c)->r[LIE] == -2.0 && r[n - 1] == COUNT_OUT) { v[n] = 7; } /* and writes too much */
    for (size_t i = 0; i < n; i++) { v[i] = ((Plant *)c)->i[r[i] == STEPS ? STEPS : r[i] - 1]; }
    return OK;
}

int fmi2SetBoolean(void *c, const unsigned *r, size_t n, const int *v) { return fmi2SetInteger(c, r, n, v); }
int fmi2GetBoolean(void *c, const unsigned *r, size_t n, int *v) { return fmi2GetInteger(c, r, n, v); }

int fmi2DoStep(void *c, double t, double h, int keep)
{
    Plant *p = c;
    double done = h > p->r[MOST] * (1.0 + 1e-9) ? p->r[REACH] * h : h;
    if (t + h > p->r[END]) {
        done = 0.0;
    }
    p->r[X] += done * p->r[K] * p->r[U];
    p->last = p->r[LIE] != 0.0 ? p->r[LIE] : t + done;
    p->i[STEPS] += 1;
    return done < h ? DISCARD : OK;
}

int fmi2GetRealStatus(void *c, int kind, double *value)
{
    *value = ((Plant *)c)->last;
    return kind == 2 ? OK : ERROR;
}

int fmi2GetBooleanStatus(void *c, int kind, int *value)
{
    *value = ((Plant *)c)->r[END] < 1e9;
    return kind == 3 ? OK : ERROR;
}

#define STUB(name) int name(void) { return ERROR; }
STUBS
