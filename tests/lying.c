/* An FMU that lies: the shipped car, whose parameter b says from t = 0.1 s on what goes wrong (see WRONG in conftest.py).

   Compiled with the car's own sources, in which the functions below have the name original_... instead. */
#include <fenv.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <unistd.h>

#ifdef FMI2
#include "fmi2Functions.h"
#define STATUS fmi2Status
#define COMPONENT fmi2Component
#define NAME(function) fmi2##function
#define GET fmi2GetReal
#define VALUES const unsigned vr[], size_t n, double y[]
#define PASSED vr, n, y
#else
#include "fmi3Functions.h"
#define STATUS fmi3Status
#define COMPONENT fmi3Instance
#define NAME(function) fmi3##function
#define GET fmi3GetFloat64
#define VALUES const unsigned vr[], size_t n, double y[], size_t m
#define PASSED vr, n, y, m
#endif

enum { SEGFAULT = 1000, EXIT, ABORT, ENDLESS, DISCARD, ERROR_, FATAL, NOT_A_NUMBER, INFINITE, RANDOM, LONG_LINE, MANY_LINES,
       CRASH_IN_GET, CRASH_IN_FREE, ENDLESS_IN_GET, KILLED, LAST_WORDS, SLEEPS, CRASH_AT_START, ENDLESS_AT_START, BAD_STATUS,
       STARTS_A_PROGRAM, EXIT_AT_START, WRITES_NOTHING, LEAVES_A_CHILD, CLOSES_ALL, GOES_ON_TWICE, BABBLES,
       ROUNDS_UP, GOES_AWAY, TAKES_CTRL_C, SPEAKS_LATE, WRITES_TOO_MUCH, REMEMBERS, REPEATS, MINUS_ONE, PRINTS, SHARES };

#ifdef FMI2
fmi2Component original_Instantiate(fmi2String, fmi2Type, fmi2String, fmi2String, const fmi2CallbackFunctions *, fmi2Boolean,
                                   fmi2Boolean);
STATUS original_DoStep(COMPONENT, double, double, int);
STATUS original_Get(COMPONENT, VALUES);
static fmi2CallbackLogger logger;
static void *environment;
static void say(const char *text) { logger(environment, "car", fmi2Warning, "logStatusWarning", text); }
#else
STATUS original_DoStep(COMPONENT, double, double, bool, bool *, bool *, bool *, double *);
STATUS original_Get(COMPONENT, VALUES);
fmi3Instance original_Instantiate(fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean, fmi3Boolean, fmi3Boolean,
                                  const fmi3ValueReference[], size_t, fmi3InstanceEnvironment, fmi3LogMessageCallback,
                                  fmi3IntermediateUpdateCallback);
static fmi3LogMessageCallback logger;
static void *environment;
static void say(const char *text) { logger(environment, fmi3Warning, "logStatusWarning", text); }
#endif
void original_Free(COMPONENT);
STATUS original_Exit(COMPONENT);

static void crash(void)
{
    volatile size_t nowhere = 8; /* of NULL a compiler knows that this cannot happen, and leaves it out */
    *(volatile int *)nowhere = 1;
}

static void for_ever(void)
{
    for (;;) {
        usleep(1000);
    }
}

static int what(COMPONENT c)
{
    const unsigned reference = 3;
    double b = 0.0;
#ifdef FMI2
    original_Get(c, &reference, 1, &b);
#else
    original_Get(c, &reference, 1, &b, 1);
#endif
    return (int)b;
}

static char *line(size_t length)
{
    char *text = malloc(length + 1);
    memset(text, 'x', length);
    text[length] = '\0';
    return text;
}

static int step(COMPONENT c, double t)
{
    static unsigned seed = 12345;
    int i;
    char *text;

    if (t < 0.09) {
        return -1;
    }
    switch (what(c)) {
    case SEGFAULT: crash(); break;
    case EXIT: exit(3);
    case ABORT: abort();
    case ENDLESS: for_ever(); break;
    case DISCARD: return 2;
    case ERROR_: return 3;
    case FATAL: return 4;
    case BAD_STATUS: return 77;
    case MINUS_ONE: return -2;
    case PRINTS: /* as a library does that nobody has asked */
        if (t < 0.11) {
            printf("the pump starts\n");
            fprintf(stderr, "a bearing is hot\n");
        } else if (t > 0.975) {
            fprintf(stderr, "the pump is to stop"); /* without the end of the line */
        }
        break;
    case KILLED: raise(SIGKILL); break;
    case RANDOM:
        seed = seed * 1103515245u + 12345u;
        if ((seed >> 16) % 8 == 0) {
            return 2 + (int)((seed >> 20) % 3);
        }
        break;
    case LONG_LINE:
        text = line(10u << 20);
        say(text);
        free(text);
        break;
    case MANY_LINES:
        if (t < 0.11) {
            for (i = 0; i < 1000000; ++i) {
                say("ten bytes.");
            }
        }
        break;
    case LAST_WORDS: say("these are my last words"); crash(); break;
    case SLEEPS: usleep(300000); break;
    case CLOSES_ALL:
        for (i = 3; i < 1000; ++i) {
            close(i);
        }
        break;
    case GOES_ON_TWICE: fork(); break;
    case ROUNDS_UP: fesetround(FE_UPWARD); break;
    case GOES_AWAY: return chdir("/") == 0 ? -1 : 4;
    case TAKES_CTRL_C: signal(SIGINT, SIG_IGN); break;
    case BABBLES: /* to whoever listens */
        for (i = 3; i < 100 && t < 0.11; ++i) {
            if (write(i, "\x7f\xff\xff\x00 and so on", 14) < 0) {
                continue;
            }
        }
        break;
    case LEAVES_A_CHILD: /* which holds all that its parent held */
        if (fork() == 0) {
            prctl(PR_SET_NAME, "left-by-an-fmu");
            sleep(1000);
            _exit(0);
        }
        crash();
        break;
    case STARTS_A_PROGRAM:
        if (fork() == 0) {
            execlp("sleep", "sleep", "1000.25", (char *)NULL);
        }
        for_ever();
    }
    return -1;
}

#ifdef FMI2
#define STATE fmi2FMUstate
#define GET_STATE fmi2GetFMUstate
#define SET_STATE fmi2SetFMUstate
#else
#define STATE fmi3FMUState
#define GET_STATE fmi3GetFMUState
#define SET_STATE fmi3SetFMUState
#endif
STATUS GET_STATE(COMPONENT, STATE *);
STATUS SET_STATE(COMPONENT, STATE);

/* Without the promise that nobody goes back the next step is taken for a repetition of this one (what() is REPEATS). */
static void repeat(COMPONENT c, int no_return)
{
    static STATE before = NULL;
    if (what(c) != REPEATS) {
        return;
    }
    if (before != NULL) {
        SET_STATE(c, before);
    } else if (!no_return) {
        GET_STATE(c, &before);
    }
}

#ifdef FMI2
STATUS fmi2DoStep(COMPONENT c, double t, double h, int n)
{
    const int status = step(c, t);
    repeat(c, n);
    return status == -2 ? (STATUS)-1 : status >= 0 ? (STATUS)status : original_DoStep(c, t, h, n);
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean on)
{
    logger = functions->logger;
    environment = functions->componentEnvironment;
    if (strstr(name, "crashes_at_once")) {
        crash();
    }
    return original_Instantiate(name, type, guid, resources, functions, visible, on);
}
#else
STATUS fmi3DoStep(COMPONENT c, double t, double h, bool n, bool *e, bool *q, bool *r, double *l)
{
    const int status = step(c, t);
    repeat(c, n);
    return status == -2 ? (STATUS)-1 : status >= 0 ? (STATUS)status : original_DoStep(c, t, h, n, e, q, r, l);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean on, fmi3Boolean event, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment e,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    logger = log;
    environment = e;
    if (strstr(name, "crashes_at_once")) {
        crash();
    }
    return original_Instantiate(name, token, resources, visible, on, event, early, required, n, e, log, update);
}
#endif

STATUS GET(COMPONENT c, VALUES)
{
    static int gets = 0, ever = 0;
    static COMPONENT before = NULL;
    const int mode = what(c);
    const STATUS status = mode == WRITES_NOTHING ? 0 : original_Get(c, PASSED);

    if (n == 1 && vr[0] == 2 && mode != WRITES_NOTHING) {
        gets = y[0] == 0.0 ? 1 : gets + 1; /* counts from the start, where the car stands */
        if (gets == 1) {
            before = c;
        }
        if (gets > 5) {
            switch (mode) {
            case NOT_A_NUMBER: y[0] = NAN; break;
            case INFINITE: y[0] = INFINITY; break;
            case CRASH_IN_GET: crash(); break;
            case ENDLESS_IN_GET: for_ever(); break;
            case SHARES: y[0] += before != c; before = c; break; /* whatever the instance before has left */
            case REMEMBERS: y[0] += ++ever; break; /* in no state that it saves */
            }
        }
        if (mode == WRITES_TOO_MUCH) {
            y[1] = 7.0;
        }
    }
    return status;
}

STATUS NAME(ExitInitializationMode)(COMPONENT c)
{
    switch (what(c)) {
    case CRASH_AT_START: say("starting badly"); crash(); break;
    case ENDLESS_AT_START: for_ever(); break;
    case EXIT_AT_START: exit(4);
    }
    return original_Exit(c);
}

void NAME(FreeInstance)(COMPONENT c)
{
    if (what(c) == CRASH_IN_FREE) {
        crash();
    }
    if (what(c) == SPEAKS_LATE) {
        original_Free(c);
        say("speaking from beyond");
        return;
    }
    original_Free(c);
}
