/* A pendulum as a model exchange FMU of FMI 2, with no more than importers call:
 * q' = w, w' = -9.81 sin q - 0.1 w + torque; value references 0 q, 1 w, 2 der(q), 3 der(w), 4 torque. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

typedef struct {
    double v[5];
} Pendulum;

static void slopes(const double *v, double *dx) {
    dx[0] = v[1];
    dx[1] = -9.81 * sin(v[0]) - 0.1 * v[1] + v[4];
}

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }
API int fmi2Reset(void *c) {
    memset(c, 0, sizeof(Pendulum));
    ((Pendulum *)c)->v[0] = 0.5;
    return 0;
}
API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *where, const void *callbacks, int visible,
                          int logging) {
    Pendulum *p = type == 0 ? malloc(sizeof(Pendulum)) : NULL;
    if (p) fmi2Reset(p);
    return p;
}
API void fmi2FreeInstance(void *c) { free(c); }
API int fmi2GetReal(void *c, const unsigned *r, size_t n, double *x) {
    double dx[2];
    slopes(((Pendulum *)c)->v, dx);
    for (size_t i = 0; i < n; i++) x[i] = r[i] == 2 || r[i] == 3 ? dx[r[i] - 2] : ((Pendulum *)c)->v[r[i]];
    return 0;
}
API int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *x) {
    for (size_t i = 0; i < n; i++) ((Pendulum *)c)->v[r[i]] = x[i];
    return 0;
}
API int fmi2SetContinuousStates(void *c, const double *x, size_t n) {
    memcpy(c, x, n * sizeof(double));
    return 0;
}
API int fmi2GetContinuousStates(void *c, double *x, size_t n) {
    memcpy(x, c, n * sizeof(double));
    return 0;
}
API int fmi2GetDerivatives(void *c, double *dx, size_t n) {
    slopes(((Pendulum *)c)->v, dx);
    return 0;
}
API int fmi2GetNominalsOfContinuousStates(void *c, double *x, size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return 0;
}
API int fmi2NewDiscreteStates(void *c, void *info) {
    memset(info, 0, 5 * sizeof(int)); /* no more events, none to come */
    return 0;
}
API int fmi2CompletedIntegratorStep(void *c, int no_return, int *enter, int *terminate) {
    *enter = *terminate = 0;
    return 0;
}
API int fmi2SetTime(void *c, double t) { return 0; }
API int fmi2GetEventIndicators(void *c, double *z, size_t n) { return 0; }
API int fmi2SetupExperiment(void *c, int a, double b, double t, int d, double e) { return 0; }

/* What changes nothing, and what is never called. */
#define NOTHING(name) API int name(void *c) { return 0; }
NOTHING(fmi2EnterInitializationMode) NOTHING(fmi2ExitInitializationMode) NOTHING(fmi2Terminate) NOTHING(fmi2EnterEventMode)
NOTHING(fmi2EnterContinuousTimeMode) NOTHING(fmi2SetDebugLogging)
#define NEVER(name) API int name(void *c) { return 3; }
NEVER(fmi2GetInteger) NEVER(fmi2GetBoolean) NEVER(fmi2GetString) NEVER(fmi2SetInteger) NEVER(fmi2SetBoolean)
NEVER(fmi2SetString) NEVER(fmi2GetFMUstate) NEVER(fmi2SetFMUstate) NEVER(fmi2FreeFMUstate) NEVER(fmi2SerializedFMUstateSize)
NEVER(fmi2SerializeFMUstate) NEVER(fmi2DeSerializeFMUstate) NEVER(fmi2GetDirectionalDerivative)
