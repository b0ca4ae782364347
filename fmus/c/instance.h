/* What both FMI wrappers share: one instance, its states, and the checks that come before the model is called.
 *
 * The functions return the numbers of fmi2Status and fmi3Status, which agree for the values used here. Whatever returns
 * ERROR has sent a message to the importer's logger and leaves the instance in the state FAILED, where the standard
 * allows only reading, restoring a saved state, resetting and freeing.
 */
#ifndef BAYESFTC_INSTANCE_H
#define BAYESFTC_INSTANCE_H

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

enum { OK = 0, WARNING = 1, DISCARD = 2, ERROR = 3 };

/* Bits, so that a set of states is a sum. */
enum { INSTANTIATED = 1, INITIALIZATION = 2, STEP = 4, TERMINATED = 8, FAILED = 16 };
enum { SETTING = INSTANTIATED + INITIALIZATION + STEP, GETTING = INITIALIZATION + STEP + TERMINATED + FAILED };

typedef enum { INPUT, OUTPUT, LOCAL, FIXED, TUNABLE, INDEPENDENT } Kind;

/* A value reference is a variable's place in this table; its elements lie one after the other from x[offset] on. */
typedef struct {
    const char *name;
    Kind kind;
    size_t offset;
    size_t size;
} Variable;

#define VARIABLE(name, kind, offset, size) { name, kind, offset, size },
static const Variable VARIABLES[MODEL_VARIABLES] = { MODEL_TABLE };
#undef VARIABLE

static const double STARTS[] = { MODEL_STARTS };

/* All that saving, restoring and serialising copies. */
typedef struct {
    int phase;
    int start_defined; /* FMI 2: fmi2SetupExperiment was called */
    int stop_defined;
    int stale; /* in initialization mode: set since the outputs were last computed */
    double stop_time;
    double x[MODEL_SIZE];
} State;

/* A serialised state is the token and the bytes of the state. A state may be large: none is ever put on the stack. */
#define TOKEN 64
#define SERIALISED (TOKEN + sizeof(State))
typedef char the_token_has_room[sizeof MODEL_TOKEN <= TOKEN ? 1 : -1];

typedef struct {
    void (*logger)(void); /* the importer's callback; each wrapper casts it back to its own type */
    void *environment;
    const char *name; /* of the instance */
} Importer;

typedef struct {
    State state;
    Importer importer;
} Instance;

/* The wrapper hands one finished line to the importer. */
static void emit(const Importer *importer, int status, const char *category, const char *line);

static void report(const Importer *importer, int status, const char *format, va_list arguments)
{
    static const char *const categories[] = { "", "logStatusWarning", "logStatusDiscard", "logStatusError" };
    char line[512];

    if (importer->logger == NULL) {
        return;
    }
    vsnprintf(line, sizeof line, format, arguments);
    emit(importer, status, categories[status], line);
}

/* A refusal that changes nothing: the importer may go on. */
static int refuse(const Importer *importer, int status, const char *format, ...)
{
    va_list arguments;

    va_start(arguments, format);
    report(importer, status, format, arguments);
    va_end(arguments);
    return status;
}

static int fail(Instance *instance, const char *format, ...)
{
    va_list arguments;

    instance->state.phase = FAILED;
    va_start(arguments, format);
    report(&instance->importer, ERROR, format, arguments);
    va_end(arguments);
    return ERROR;
}

static const char *phase_name(int phase)
{
    switch (phase) {
    case INSTANTIATED: return "instantiated";
    case INITIALIZATION: return "initialization mode";
    case STEP: return "step mode";
    case TERMINATED: return "terminated";
    default: return "error";
    }
}

/* OK where `function` may be called in the present state; `when` says in words where that is. */
static int check_phase(Instance *instance, const char *function, int phases, const char *when)
{
    if (instance == NULL) {
        return ERROR;
    }
    if (instance->state.phase & phases) {
        return OK;
    }
    return fail(instance, "%s: not allowed in the state '%s'; call it %s.", function, phase_name(instance->state.phase), when);
}

static int unsupported(Instance *instance, const char *function, const char *reason)
{
    if (instance == NULL) {
        return ERROR;
    }
    return fail(instance, "%s: not supported, because %s.", function, reason);
}

/* Getting or setting variables of a type that the model has none of: right only for an empty list. */
static int no_such_type(Instance *instance, const char *function, const unsigned int *references, size_t count)
{
    if (instance == NULL) {
        return ERROR;
    }
    if (count == 0) {
        return OK;
    }
    return fail(instance, "%s: value reference %u has another type; all variables of %s are double-precision numbers.",
                function, references[0], MODEL_NAME);
}

static void reset_state(State *state)
{
    size_t i;

    memset(state, 0, sizeof *state); /* also the padding, so that equal states serialise to equal bytes */
    state->phase = INSTANTIATED;
    for (i = 0; i < X_TIME; ++i) {
        state->x[i] = STARTS[i];
    }
}

/* The name is copied behind the instance: one allocation, and none after it but for saved states. */
static Instance *new_instance(const Importer *importer)
{
    const size_t length = strlen(importer->name) + 1;
    Instance *instance = (Instance *)calloc(1, sizeof *instance + length);

    if (instance == NULL) {
        refuse(importer, ERROR, "Instantiation: no memory for the instance '%s'.", importer->name);
        return NULL;
    }
    instance->importer = *importer;
    instance->importer.name = (const char *)memcpy(instance + 1, importer->name, length);
    reset_state(&instance->state);
    return instance;
}

/* The part of instantiation that FMI 2 and 3 have in common; NULL after a message where it cannot be. */
static Instance *instantiate(Importer *importer, const char *name, const char *token, const char *obstacle)
{
    importer->name = name == NULL ? "" : name;
    if (importer->name[0] == '\0') {
        refuse(importer, ERROR, "Instantiation: the instance of %s has no name; give a name that is not empty.", MODEL_NAME);
        return NULL;
    }
    if (token == NULL || strcmp(token, MODEL_TOKEN) != 0) {
        refuse(importer, ERROR, "Instantiation: the token '%s' is not that of this %s, '%s'; the model description and the "
               "binary come from different builds.", token == NULL ? "" : token, MODEL_NAME, MODEL_TOKEN);
        return NULL;
    }
    if (obstacle != NULL) {
        refuse(importer, ERROR, "Instantiation: %s is for co-simulation only, without event mode and intermediate updates; "
               "%s was asked for.", MODEL_NAME, obstacle);
        return NULL;
    }
    return new_instance(importer);
}

static int set_times(Instance *instance, const char *function, double start, int stop_defined, double stop)
{
    if (!isfinite(start)) {
        return fail(instance, "%s: the start time %g is not finite.", function, start);
    }
    if (stop_defined && !(stop >= start)) {
        return fail(instance, "%s: the stop time %.17g lies before the start time %.17g.", function, stop, start);
    }
    instance->state.x[X_TIME] = start;
    instance->state.stop_defined = stop_defined != 0;
    instance->state.stop_time = stop_defined ? stop : 0.0;
    instance->state.start_defined = 1;
    return OK;
}

static void enter_initialization(Instance *instance)
{
    instance->state.phase = INITIALIZATION;
    instance->state.stale = 1;
}

static void refresh(Instance *instance)
{
    if (instance->state.phase == INITIALIZATION && instance->state.stale) {
        model_initialize(instance->state.x);
        instance->state.stale = 0;
    }
}

static int exit_initialization(Instance *instance, const char *function)
{
    const int status = check_phase(instance, function, INITIALIZATION, "in initialization mode");

    if (status != OK) {
        return status;
    }
    refresh(instance);
    instance->state.phase = STEP;
    return OK;
}

/* OK where all references are known and the variables have as many elements as there are values. */
static int check_references(Instance *instance, const char *function, const unsigned int *references, size_t count,
                            size_t values)
{
    size_t elements = 0;
    size_t i;

    for (i = 0; i < count; ++i) {
        if (references[i] >= MODEL_VARIABLES) {
            return fail(instance, "%s: %s has no variable with the value reference %u.", function, MODEL_NAME, references[i]);
        }
        elements += VARIABLES[references[i]].size;
    }
    if (elements != values) {
        return fail(instance, "%s: %lu values for variables with %lu elements.", function, (unsigned long)values,
                    (unsigned long)elements);
    }
    return OK;
}

static int get_values(Instance *instance, const char *function, const unsigned int *references, size_t count, double *values,
                      size_t size)
{
    int status = check_phase(instance, function, GETTING, "from initialization mode on");
    size_t i;

    if (status == OK) {
        status = check_references(instance, function, references, count, size);
    }
    if (status != OK) {
        return status;
    }
    refresh(instance);
    for (i = 0; i < count; ++i) {
        const Variable *variable = &VARIABLES[references[i]];

        memcpy(values, instance->state.x + variable->offset, variable->size * sizeof *values);
        values += variable->size;
    }
    return OK;
}

/* The states in which a variable may be set, and what to say where it may not. */
static int settable(Kind kind)
{
    switch (kind) {
    case INPUT:
    case TUNABLE: return SETTING;
    case FIXED: return INSTANTIATED + INITIALIZATION;
    default: return 0;
    }
}

static int set_values(Instance *instance, const char *function, const unsigned int *references, size_t count,
                      const double *values, size_t size)
{
    int status = check_phase(instance, function, SETTING, "before or in step mode");
    size_t i;

    /* All are checked before the first is written: a refused call has changed no value. */
    if (status == OK) {
        status = check_references(instance, function, references, count, size);
    }
    if (status != OK) {
        return status;
    }
    for (i = 0; i < count; ++i) {
        const Variable *variable = &VARIABLES[references[i]];

        if (!(settable(variable->kind) & instance->state.phase)) {
            return fail(instance, variable->kind == FIXED
                        ? "%s: '%s' (value reference %u) is a fixed parameter; set it before initialization ends."
                        : "%s: '%s' (value reference %u) is computed by the model and cannot be set.",
                        function, variable->name, references[i]);
        }
    }
    for (i = 0; i < count; ++i) {
        const Variable *variable = &VARIABLES[references[i]];

        memcpy(instance->state.x + variable->offset, values, variable->size * sizeof *values);
        values += variable->size;
    }
    instance->state.stale = 1;
    return OK;
}

/* How far apart two spellings of a time may be: by what rounding leaves, and never by a part of a step that matters. */
static double slack(double time, double h)
{
    const double size = fabs(time);
    const double usual = 1e-9 * (size > h ? size : h);

    return (usual < 0.01 * h ? usual : 0.01 * h) + 1e-15 * size;
}

#ifdef MODEL_FIXED_STEP
/* Importers compute the step as a difference of two times, too, which is rounded the more the later it is; some count whole
 * nanoseconds, of which a thirtieth of a second has none. */
static int is_fixed_step(double time, double h)
{
    const double nanosecond = 1e-4 * MODEL_FIXED_STEP < 1e-9 ? 1e-4 * MODEL_FIXED_STEP : 1e-9;

    return fabs(h - MODEL_FIXED_STEP) <= nanosecond + 1e-9 * MODEL_FIXED_STEP + 1e-15 * fabs(time);
}
#endif

static int do_step(Instance *instance, const char *function, double point, double h)
{
    const int status = check_phase(instance, function, STEP, "after initialization and before termination");
    double time;
    int code;

    if (status != OK) {
        return status;
    }
    time = instance->state.x[X_TIME];
    if (!(h > 0.0) || !isfinite(h)) {
        return fail(instance, "%s: the communication step size %.17g must be positive and finite.", function, h);
    }
#ifdef MODEL_FIXED_STEP
    if (!is_fixed_step(time, h)) {
        return fail(instance, "%s: the communication step size %.17g must be %.17g, for which %s was made.", function, h,
                    MODEL_FIXED_STEP, MODEL_NAME);
    }
#endif
    if (!(fabs(point - time) <= slack(time, h))) {
        return fail(instance, "%s: the communication point %.17g is not the time %.17g at which this instance stands.",
                    function, point, time);
    }
    if (instance->state.stop_defined && point + h > instance->state.stop_time + slack(instance->state.stop_time, h)) {
        return fail(instance, "%s: the step from %.17g to %.17g passes the stop time %.17g.", function, point, point + h,
                    instance->state.stop_time);
    }
    code = model_step(instance->state.x, h);
    if (code != 0) {
        return fail(instance, "%s: the model could not go from %.17g to %.17g (code %d).", function, point, point + h, code);
    }
    instance->state.x[X_TIME] = point + h; /* the importer's points, so that rounding does not add up */
    return OK;
}

static int get_state(Instance *instance, const char *function, void **saved)
{
    if (instance == NULL) {
        return ERROR;
    }
    if (saved == NULL) {
        return fail(instance, "%s: there is no place to put the saved state.", function);
    }
    if (*saved == NULL) {
        *saved = malloc(sizeof(State));
    }
    if (*saved == NULL) {
        return fail(instance, "%s: no memory for a saved state.", function);
    }
    memcpy(*saved, &instance->state, sizeof(State));
    return OK;
}

static int set_state(Instance *instance, const char *function, const void *saved)
{
    if (instance == NULL) {
        return ERROR;
    }
    if (saved == NULL) {
        return fail(instance, "%s: the saved state is NULL.", function);
    }
    memcpy(&instance->state, saved, sizeof(State));
    return OK;
}

static int free_state(Instance *instance, void **saved)
{
    if (instance == NULL) {
        return ERROR;
    }
    if (saved != NULL) {
        free(*saved);
        *saved = NULL;
    }
    return OK;
}

static int serialised_size(Instance *instance, const char *function, const void *saved, size_t *size)
{
    if (instance == NULL) {
        return ERROR;
    }
    if (saved == NULL || size == NULL) {
        return fail(instance, "%s: the saved state or the place for its size is NULL.", function);
    }
    *size = SERIALISED;
    return OK;
}

static int serialise(Instance *instance, const char *function, const void *saved, void *bytes, size_t size)
{
    if (instance == NULL) {
        return ERROR;
    }
    if (saved == NULL || bytes == NULL || size < SERIALISED) {
        return fail(instance, "%s: the saved state or the buffer is NULL, or the buffer is smaller than %lu bytes.", function,
                    (unsigned long)SERIALISED);
    }
    memset(bytes, 0, TOKEN);
    memcpy(bytes, MODEL_TOKEN, sizeof MODEL_TOKEN);
    memcpy((char *)bytes + TOKEN, saved, sizeof(State));
    return OK;
}

static int deserialise(Instance *instance, const char *function, const void *bytes, size_t size, void **saved)
{
    if (instance == NULL) {
        return ERROR;
    }
    if (bytes == NULL || saved == NULL || size != SERIALISED) {
        return fail(instance, "%s: a serialised state of %s has %lu bytes, not %lu.", function, MODEL_NAME,
                    (unsigned long)SERIALISED, (unsigned long)(bytes == NULL ? 0 : size));
    }
    if (memcmp(bytes, MODEL_TOKEN, sizeof MODEL_TOKEN) != 0) {
        return fail(instance, "%s: the bytes are not a serialised state of this build of %s.", function, MODEL_NAME);
    }
    if (*saved == NULL) {
        *saved = malloc(sizeof(State));
    }
    if (*saved == NULL) {
        return fail(instance, "%s: no memory for a saved state.", function);
    }
    memcpy(*saved, (const char *)bytes + TOKEN, sizeof(State));
    return OK;
}

static int terminate(Instance *instance, const char *function)
{
    const int status = check_phase(instance, function, STEP, "in step mode");

    if (status == OK) {
        instance->state.phase = TERMINATED;
    }
    return status;
}

static int reset(Instance *instance)
{
    if (instance == NULL) {
        return ERROR;
    }
    reset_state(&instance->state);
    return OK;
}

/* There are no debug messages to switch; errors are always reported. */
static int set_logging(Instance *instance, const char *function, size_t count, const char *const *categories)
{
    size_t i;

    if (instance == NULL) {
        return ERROR;
    }
    for (i = 0; i < count; ++i) {
        const char *category = categories[i] == NULL ? "" : categories[i];

        if (strcmp(category, "logStatusWarning") != 0 && strcmp(category, "logStatusDiscard") != 0
            && strcmp(category, "logStatusError") != 0) {
            return refuse(&instance->importer, WARNING, "%s: %s has no log category '%s'.", function, MODEL_NAME, category);
        }
    }
    return OK;
}

#endif
