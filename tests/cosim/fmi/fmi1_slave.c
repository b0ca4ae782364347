/* An FMU of FMI 1 for co-simulation: x' = k u, exactly; what goes in as Integer, Boolean or enumeration comes out. By `lie` it
 * refuses to be initialized (1), discards a step from 0.3 s on (2), fails there (3), says what FMI does not know there (77). */
#include <stdlib.h>
#include <string.h>
#include "fmi1Functions.h"

enum { U, K, X, LIE, REALS };

typedef struct {
    fmi1CallbackFunctions f;
    double r[REALS], t;
    int i, e, initialized;
    char b, name[99];
} Plant;

#define FUNCTION(name) Slave_fmi##name
#define P ((Plant *)c)

static int say(Plant *p, int status, const char *text) {
    p->f.logger(p, p->name, (fmi1Status)status, "problem", "%s: %s at t = %g", p->name, text, p->t);
    return status;
}

const char *FUNCTION(GetVersion)(void) { return "1.0"; }
const char *FUNCTION(GetTypesPlatform)(void) { return "standard32"; }
int FUNCTION(SetDebugLogging)(void *c, char on) { return 0; }
void *FUNCTION(InstantiateSlave)(const char *name, const char *guid, const char *where, const char *mime, double timeout,
                                 char visible, char interactive, fmi1CallbackFunctions f, char on) {
    Plant *p;
    if (strcmp(guid, "{slave}") || strncmp(where, "file:///", 8)) {
        f.logger(NULL, name, fmi1Error, "problem", "the guid is %s, not mine", guid);
        return NULL;
    }
    p = f.allocateMemory(1, sizeof(Plant));
    p->f = f;
    p->r[K] = 1;
    p->e = 1;
    strncpy(p->name, name, 98);
    return p;
}
void FUNCTION(FreeSlaveInstance)(void *c) { P->f.freeMemory(c); }
int FUNCTION(InitializeSlave)(void *c, double start, char ends, double stop) {
    if (P->r[LIE] == 1 || P->initialized) return say(P, 3, "no way to begin");
    P->t = start;
    P->initialized = 1;
    return 0;
}
int FUNCTION(TerminateSlave)(void *c) { return say(P, P->initialized ? 0 : 3, "terminated"); }
int FUNCTION(ResetSlave)(void *c) { return 3; }
int FUNCTION(DoStep)(void *c, double t, double h, char new_step) {
    if (!P->initialized || !new_step || t < P->t - 1e-9 || t > P->t + 1e-9) return say(P, 3, "not the next step");
    if (P->r[LIE] > 1 && t > 0.29) return say(P, (int)P->r[LIE], "the belt is off");
    P->r[X] += h * P->r[K] * P->r[U];
    P->t = t + h;
    return 0;
}
int FUNCTION(GetReal)(void *c, const unsigned r[], size_t n, double x[]) {
    for (size_t i = 0; i < n; i++) x[i] = P->r[r[i]];
    return 0;
}
int FUNCTION(SetReal)(void *c, const unsigned r[], size_t n, const double x[]) {
    for (size_t i = 0; i < n; i++) P->r[r[i]] = x[i];
    return 0;
}
#define VALUES(name, type, member) \
    int FUNCTION(Get##name)(void *c, const unsigned r[], size_t n, type x[]) { \
        for (size_t i = 0; i < n; i++) x[i] = r[i] ? P->e : P->member; \
        return 0; \
    } \
    int FUNCTION(Set##name)(void *c, const unsigned r[], size_t n, const type x[]) { \
        for (size_t i = 0; i < n; i++) if (r[i]) P->e = x[i]; else P->member = x[i]; \
        return 0; \
    }
VALUES(Integer, int, i)
VALUES(Boolean, char, b)
int FUNCTION(GetString)(void *c, const unsigned r[], size_t n, const char *x[]) { return n ? 3 : 0; }
int FUNCTION(SetString)(void *c, const unsigned r[], size_t n, const char *const x[]) { return n ? 3 : 0; }
int FUNCTION(SetRealInputDerivatives)(void *c, const unsigned r[], size_t n, const int o[], const double x[]) { return 3; }
int FUNCTION(GetRealOutputDerivatives)(void *c, const unsigned r[], size_t n, const int o[], double x[]) { return 3; }
int FUNCTION(CancelStep)(void *c) { return 3; }
int FUNCTION(GetStatus)(void *c, int kind, int *status) { return 2; }
int FUNCTION(GetRealStatus)(void *c, int kind, double *t) { *t = P->t; return kind == fmi1LastSuccessfulTime ? 0 : 2; }
int FUNCTION(GetIntegerStatus)(void *c, int kind, int *x) { return 2; }
int FUNCTION(GetBooleanStatus)(void *c, int kind, char *x) { return 2; }
int FUNCTION(GetStringStatus)(void *c, int kind, const char **x) { return 2; }
