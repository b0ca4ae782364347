/* Runs an FMU of FMI 2 beside no Python: driver LIBRARY GUID STEP INPUTS OUTPUTS < doubles > doubles.
 *
 * With LINKED the FMU's sources are linked into this program, and LIBRARY is ignored.
 *
 * From stdin the inputs of each step, to stdout the outputs after it, as the bytes of doubles. The value references are those
 * that an exported block has: its inputs, then its outputs. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#ifdef LINKED
#define OPEN(path) ((void *)(path))
#define GET(function) function
#else
#define GET(function) ((function##TYPE *)find(#function))
#endif

#if defined LINKED
#elif defined _WIN32
#include <fcntl.h>
#include <io.h>
#include <windows.h>
#define OPEN(path) ((void *)LoadLibraryA(path))
#define FIND(library, name) ((void *)GetProcAddress((HMODULE)(library), name))
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define FIND(library, name) dlsym(library, name)
#endif

static void log_line(void *environment, fmi2String instance, fmi2Status status, fmi2String category, fmi2String line, ...)
{
    (void)environment;
    fprintf(stderr, "%s: %s (%d): %s\n", instance, category, (int)status, line);
}

static void *library;

#ifndef LINKED
static void *find(const char *name)
{
    void *found = FIND(library, name);

    if (found == NULL) {
        fprintf(stderr, "no %s\n", name);
        exit(3);
    }
    return found;
}
#endif

#define CALL(function, ...) \
    do { \
        if (GET(function)(__VA_ARGS__) != fmi2OK) { \
            fprintf(stderr, #function " failed\n"); \
            return 4; \
        } \
    } while (0)

int main(int count, char **arguments)
{
    const fmi2CallbackFunctions callbacks = { log_line, calloc, free, NULL, NULL };
    fmi2ValueReference references[256];
    double values[256];
    fmi2Component c;
    double step;
    size_t inputs, outputs;
    long k;

    if (count != 6 || (library = OPEN(arguments[1])) == NULL) {
        fprintf(stderr, "cannot load %s\n", count > 1 ? arguments[1] : "nothing");
        return 2;
    }
#ifdef _WIN32
    _setmode(_fileno(stdin), _O_BINARY);
    _setmode(_fileno(stdout), _O_BINARY);
#endif
    step = atof(arguments[3]);
    inputs = (size_t)atoi(arguments[4]);
    outputs = (size_t)atoi(arguments[5]);
    for (k = 0; k < 256; ++k) {
        references[k] = (fmi2ValueReference)k;
    }
    c = GET(fmi2Instantiate)("driven", fmi2CoSimulation, arguments[2], "", &callbacks, fmi2False, fmi2False);
    if (c == NULL) {
        return 3;
    }
    CALL(fmi2SetupExperiment, c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    CALL(fmi2EnterInitializationMode, c);
    CALL(fmi2ExitInitializationMode, c);
    for (k = 0; fread(values, sizeof *values, inputs, stdin) == inputs; ++k) {
        CALL(fmi2SetReal, c, references, inputs, values);
        CALL(fmi2DoStep, c, k * step, step, fmi2True);
        CALL(fmi2GetReal, c, references + inputs, outputs, values);
        fwrite(values, sizeof *values, outputs, stdout);
    }
    GET(fmi2FreeInstance)(c);
    return 0;
}
