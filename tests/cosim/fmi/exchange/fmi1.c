/* The models of models.c as FMUs of FMI 1: without modes, so that what those check is brought about here, and with names that begin
 * with the model's. */
#include "models.c"

#define NAME(name) models_fmi##name
#define GET1(name, type, kinds) int NAME(name)(void *c, const unsigned r[], size_t n, type x[]) GET(name, type, kinds, n)
#define SET1(name, type, kinds) \
    static SET2(fmi1_##name, type, kinds) \
    int NAME(name)(void *c, const unsigned r[], size_t n, const type x[]) { \
        int mode = M->s.mode, status; \
        if (mode == CONTINUOUS) M->s.mode = EVENT; \
        status = fmi1_##name(c, r, n, x); \
        M->s.mode = mode; \
        return status; \
    }

typedef struct { fmi2CallbackLogger logger; void *allocate, *release, *finished; } Callbacks1;
typedef struct { char converged, references, values, terminate, defined; double next; } EventInfo1;

const char *NAME(GetVersion)(void) { return "1.0"; }
const char *NAME(GetModelTypesPlatform)(void) { return "standard32"; }
int NAME(SetDebugLogging)(void *c, char on) { return 0; }
void *NAME(InstantiateModel)(const char *name, const char *token, Callbacks1 f, char on) {
    Instance *m = make(token);
    if (m) m->log2 = f.logger, m->environment = m;
    return m;
}
void NAME(FreeModelInstance)(void *c) { free(c); }
int NAME(Terminate)(void *c) { return say(M, 0, "terminated"); }

GET1(GetReal, double, "D") SET1(SetReal, double, "D")
GET1(GetInteger, int, "iE") SET1(SetInteger, int, "iE")
GET1(GetBoolean, char, "B") SET1(SetBoolean, char, "B")
int NAME(GetString)(void *c, const unsigned r[], size_t n, const char *x[]) { return n ? 3 : 0; }
int NAME(SetString)(void *c, const unsigned r[], size_t n, const char *const x[]) { return n ? 3 : 0; }

int NAME(SetTime)(void *c, double t) {
    if (M->s.mode == CONTINUOUS) return now(M, t);
    M->s.t = t;
    return 0;
}
static int turn(Instance *m, EventInfo1 *e) {
    int needed, terminate, changed, defined, status;
    m->s.mode = EVENT;
    m->s.began = m->s.t;
    status = update(m, &needed, &terminate, &changed, &defined, &e->next);
    m->s.mode = CONTINUOUS;
    e->converged = !needed, e->values = changed, e->terminate = terminate, e->defined = defined;
    e->references = m->s.model == SCALE && !m->s.v[10];
    return status;
}
int NAME(Initialize)(void *c, char controlled, double tolerance, EventInfo1 *e) {
    return M->s.mode == START ? turn(M, e) : say(M, 3, "initialized twice");
}
int NAME(EventUpdate)(void *c, char between, EventInfo1 *e) {
    return M->s.mode == CONTINUOUS && !between ? turn(M, e) : say(M, 3, "not initialized");
}
int NAME(CompletedIntegratorStep)(void *c, char *enter) {
    int wants, ends, status = completed(M, &wants, &ends);
    *enter = wants;
    return status;
}
int NAME(SetContinuousStates)(void *c, const double x[], size_t n) { return write_states(M, x, n); }
int NAME(GetContinuousStates)(void *c, double x[], size_t n) { return read_states(M, x, n); }
int NAME(GetNominalContinuousStates)(void *c, double x[], size_t n) { return nominals(M, x, n); }
int NAME(GetDerivatives)(void *c, double x[], size_t n) { return derivatives(M, x); }
int NAME(GetEventIndicators)(void *c, double z[], size_t n) { return reached(M, z); }
int NAME(GetStateValueReferences)(void *c, unsigned r[], size_t n) {
    if (M->s.model == PULSE) return say(M, 3, "not implemented");
    for (size_t i = 0; i < n; i++) r[i] = M->s.model == STACK ? -1 : i; /* -1: not said */
    return 0;
}
