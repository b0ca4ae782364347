/* A model exchange FMU of FMI 2 with directional derivatives, for tests:
 *
 *     x' = v,  v' = -x^3 + u cos x,  y = x v
 *
 * Beyond x = 10 its derivatives are an error, below -10 they are discarded. After an error every call fails, as FMI allows.
 */
#include <math.h>
#include <stdlib.h>

#include "fmi2Functions.h"

/* Value references: 0 x, 1 v, 2 x', 3 v', 4 u, 5 y. */
typedef struct { double x[2], u; int failed; } Instance;
#define M ((Instance *)c)
#define SOUND if (M->failed) return fmi2Error

const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions *f, fmi2Boolean v,
                              fmi2Boolean l) {
    Instance *m = calloc(1, sizeof(Instance));
    m->x[0] = 0.5;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
static fmi2Status fine(fmi2Component c) { SOUND; return fmi2OK; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean l, size_t n, const fmi2String k[]) { return fine(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real e, fmi2Real b, fmi2Boolean s, fmi2Real t) { return fine(c); }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fine(c); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fine(c); }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fine(c); }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fine(c); }
fmi2Status fmi2Terminate(fmi2Component c) { return fine(c); }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *e) { return fine(c); }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean n, fmi2Boolean *e, fmi2Boolean *t) {
    *e = *t = fmi2False;
    return fine(c);
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { return fine(c); }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    SOUND;
    M->x[0] = x[0], M->x[1] = x[1];
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    SOUND;
    x[0] = M->x[0], x[1] = M->x[1];
    return fmi2OK;
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = x[1] = 1; return fine(c); }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { return fine(c); }
static double value(Instance *m, fmi2ValueReference r) {
    switch (r) {
    case 2: return m->x[1];
    case 3: return -m->x[0] * m->x[0] * m->x[0] + m->u * cos(m->x[0]);
    case 4: return m->u;
    case 5: return m->x[0] * m->x[1];
    default: return m->x[r];
    }
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real d[], size_t n) {
    SOUND;
    if (M->x[0] > 10) return M->failed = 1, fmi2Error;
    if (M->x[0] < -10) return fmi2Discard;
    d[0] = value(M, 2), d[1] = value(M, 3);
    return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    SOUND;
    for (size_t i = 0; i < n; i++) v[i] = value(M, r[i]);
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    SOUND;
    for (size_t i = 0; i < n; i++)
        if (r[i] == 4) M->u = v[i]; else M->x[r[i]] = v[i];
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference z[], size_t nz, const fmi2ValueReference v[],
                                        size_t nv, const fmi2Real dv[], fmi2Real dz[]) {
    double dx[2] = {0, 0}, du = 0;
    SOUND;
    for (size_t i = 0; i < nv; i++)
        if (v[i] == 4) du = dv[i]; else dx[v[i]] = dv[i];
    for (size_t i = 0; i < nz; i++)
        switch (z[i]) {
        case 2: dz[i] = dx[1]; break;
        case 3: dz[i] = (-3 * M->x[0] * M->x[0] - M->u * sin(M->x[0])) * dx[0] + cos(M->x[0]) * du; break;
        case 5: dz[i] = M->x[1] * dx[0] + M->x[0] * dx[1]; break;
        default: dz[i] = dx[z[i]];
        }
    return fmi2OK;
}
