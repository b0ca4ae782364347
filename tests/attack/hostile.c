/* A plant x' = u - x, y = x as an FMU of FMI 2 or 3, for co-simulation and model exchange, that goes wrong where it is told to.
 *
 * The environment says in HOSTILE which function goes wrong, from which call on, and in which way: "DoStep 3 crash". Ways are
 * crash, exit, abort, kill, hang, thread, print, fork, close, mask, huge (a wish for a terabyte) and many (100 MB), the values
 * nan, inf, 1e300 and none (nothing is written), and any number, which is then the status.
 */
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifdef FMI2
#define FMI(name) fmi2##name
#define FLAG int
#else
#define FMI(name) fmi3##name
#define FLAG bool
#endif

typedef struct { double x, u, t; } Plant;
static char way[32];

static void *spin(void *nothing) { for (;;) usleep(1000); }

/* Return the status that a function has to return at once, or -1; `way` says what is left to do. */
static int trap(const char *function)
{
    static int calls = 0, once = 0;
    const char *text = getenv("HOSTILE");
    char name[64] = "";
    int from = 0;
    pthread_t thread;

    way[0] = '\0';
    if (!text || sscanf(text, "%63s %d %31s", name, &from, way) != 3 || strcmp(name, function) || ++calls < from) {
        way[0] = '\0';
        return -1;
    }
    if (!strcmp(way, "crash")) { volatile size_t nowhere = 8; *(volatile int *)nowhere = 1; }
    if (!strcmp(way, "exit")) exit(3);
    if (!strcmp(way, "abort")) abort();
    if (!strcmp(way, "kill")) raise(SIGKILL);
    if (!strcmp(way, "hang")) spin(NULL);
    if (!strcmp(way, "thread") && !once++) pthread_create(&thread, NULL, spin, NULL);
    if (!strcmp(way, "print")) { printf("%0100d\n", 1); fprintf(stderr, "%0100d\n", 2); }
    if (!strcmp(way, "fork") && !once++ && fork() == 0) { sleep(1000); _exit(0); }
    if (!strcmp(way, "close")) for (int i = 3; i < 256; ++i) close(i);
    if (!strcmp(way, "mask")) { signal(SIGINT, SIG_IGN); signal(SIGTERM, SIG_IGN); signal(SIGCHLD, SIG_IGN); }
    if (!strcmp(way, "huge")) free(malloc((size_t)1 << 40));
    if (!strcmp(way, "many")) { char *much = malloc(100u << 20); if (much) memset(much, 1, 100u << 20); free(much); }
    return (way[0] >= '0' && way[0] <= '9' && strcmp(way, "1e300")) || way[0] == '-' ? atoi(way) : -1;
}

#define TRAP(name) do { int status = trap(name); if (way[0] && status != -1) return status; } while (0)

static int give(double *to, double value)
{
    if (!strcmp(way, "none")) return 0;
    *to = !strcmp(way, "nan") ? NAN : !strcmp(way, "inf") ? INFINITY : !strcmp(way, "1e300") ? 1e300 : value;
    return 0;
}

#ifdef FMI2
const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
void *fmi2Instantiate(const char *name, int type, const char *token, const char *path, const void *callbacks, int v, int l)
#else
const char *fmi3GetVersion(void) { return "3.0"; }
static void *make(void)
#endif
{
    if (trap("Instantiate") > 0) return NULL;
    return calloc(1, sizeof(Plant));
}
#ifndef FMI2
void *fmi3InstantiateModelExchange(const char *n, const char *t, const char *p, bool v, bool l, void *e, void *log) { return make(); }
void *fmi3InstantiateCoSimulation(const char *n, const char *t, const char *p, bool v, bool l, bool ev, bool er,
                                  const unsigned *r, size_t nr, void *e, void *log, void *update) { return make(); }
#endif
void FMI(FreeInstance)(void *c) { trap("FreeInstance"); free(c); }
int FMI(SetDebugLogging)(void *c, FLAG on, size_t n, const char *const names[]) { TRAP("SetDebugLogging"); return 0; }
#ifdef FMI2
int fmi2SetupExperiment(void *c, int d, double tolerance, double t, int s, double stop) { TRAP("SetupExperiment"); return 0; }
int fmi2EnterInitializationMode(void *c) { TRAP("EnterInitializationMode"); return 0; }
#else
int fmi3EnterInitializationMode(void *c, bool d, double tolerance, double t, bool s, double stop) { TRAP("EnterInitializationMode"); return 0; }
#endif
int FMI(ExitInitializationMode)(void *c) { TRAP("ExitInitializationMode"); return 0; }
int FMI(Terminate)(void *c) { TRAP("Terminate"); return 0; }
int FMI(Reset)(void *c) { memset(c, 0, sizeof(Plant)); return 0; }

/* Value references: 0 u, 1 x, 2 x', 3 y. */
static int get(Plant *p, const unsigned *r, size_t n, double *y)
{
    TRAP("Get");
    for (size_t i = 0; i < n; ++i) give(y + i, r[i] == 0 ? p->u : r[i] == 2 ? p->u - p->x : p->x);
    return 0;
}
static int set(Plant *p, const unsigned *r, size_t n, const double *y)
{
    TRAP("Set");
    for (size_t i = 0; i < n; ++i) *(r[i] == 0 ? &p->u : &p->x) = y[i];
    return 0;
}
#ifdef FMI2
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *y) { return get(c, r, n, y); }
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *y) { return set(c, r, n, y); }
int fmi2DoStep(void *c, double t, double h, int no)
#else
int fmi3GetFloat64(void *c, const unsigned *r, size_t n, double *y, size_t m) { return get(c, r, n, y); }
int fmi3SetFloat64(void *c, const unsigned *r, size_t n, const double *y, size_t m) { return set(c, r, n, y); }
int fmi3DoStep(void *c, double t, double h, bool no, bool *event, bool *end, bool *early, double *last)
#endif
{
    Plant *p = c;
    TRAP("DoStep");
    p->x += (p->u - p->x) * (1.0 - exp(-h));
#ifndef FMI2
    *event = *end = *early = false;
    give(last, t + h);
#endif
    return 0;
}

int FMI(SetTime)(void *c, double t) { TRAP("SetTime"); ((Plant *)c)->t = t; return 0; }
int FMI(EnterEventMode)(void *c) { TRAP("EnterEventMode"); return 0; }
int FMI(EnterContinuousTimeMode)(void *c) { TRAP("EnterContinuousTimeMode"); return 0; }
int FMI(SetContinuousStates)(void *c, const double x[], size_t n) { TRAP("SetContinuousStates"); ((Plant *)c)->x = x[0]; return 0; }
int FMI(GetContinuousStates)(void *c, double x[], size_t n) { TRAP("GetContinuousStates"); return give(x, ((Plant *)c)->x); }
int FMI(GetNominalsOfContinuousStates)(void *c, double x[], size_t n) { TRAP("GetNominals"); return give(x, 1.0); }
int FMI(GetEventIndicators)(void *c, double z[], size_t n) { TRAP("GetEventIndicators"); return give(z, ((Plant *)c)->x - 0.005); }
static int derivatives(Plant *p, double *x) { TRAP("GetDerivatives"); return give(x, p->u - p->x); }
int FMI(CompletedIntegratorStep)(void *c, FLAG no, FLAG *enter, FLAG *end)
{
    TRAP("CompletedIntegratorStep");
    *enter = !strcmp(way, "nan"); /* an event after each step */
    *end = 0;
    return 0;
}
#ifdef FMI2
int fmi2GetDerivatives(void *c, double x[], size_t n) { return derivatives(c, x); }
typedef struct { int needed, terminate, nominals, values, defined; double next; } Info;
int fmi2NewDiscreteStates(void *c, Info *info)
{
    TRAP("NewDiscreteStates");
    memset(info, 0, sizeof *info);
    info->defined = way[0] != '\0';
    info->needed = !strcmp(way, "none"); /* without end */
    return give(&info->next, 0.0);
}
#else
int fmi3GetContinuousStateDerivatives(void *c, double x[], size_t n) { return derivatives(c, x); }
int fmi3GetNumberOfContinuousStates(void *c, size_t *n) { TRAP("GetNumbers"); *n = way[0] ? (size_t)-1 : 1; return 0; }
int fmi3GetNumberOfEventIndicators(void *c, size_t *n) { TRAP("GetNumbers"); *n = way[0] ? 1000000 : 1; return 0; }
int fmi3UpdateDiscreteStates(void *c, bool *needed, bool *terminate, bool *nominals, bool *values, bool *defined, double *next)
{
    TRAP("NewDiscreteStates");
    *terminate = *nominals = *values = false;
    *defined = way[0] != '\0';
    *needed = !strcmp(way, "none");
    return give(next, 0.0);
}
#endif
