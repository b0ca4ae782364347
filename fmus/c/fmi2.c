/* FMI 2.0 for co-simulation around any model that keeps the contract of model.h. */
#include "fmi2Functions.h"
#include "instance.h"

/* instance.h returns plain numbers for both standards: stop the compiler where they would mean something else. */
typedef char the_status_values_agree[(int)fmi2OK == OK && (int)fmi2Warning == WARNING && (int)fmi2Discard == DISCARD
                                     && (int)fmi2Error == ERROR ? 1 : -1];

static void emit(const Importer *importer, int status, const char *category, const char *line)
{
    const fmi2CallbackLogger logger = (fmi2CallbackLogger)importer->logger;
    char format[1024]; /* a line has at most 511 characters, and each may double */
    size_t used = 0;

    /* The line is the format, so that importers which cannot format see the text too; hence no lone percent sign. */
    for (; *line != '\0'; ++line) {
        if (*line == '%') {
            format[used++] = '%';
        }
        format[used++] = *line;
    }
    format[used] = '\0';
    logger(importer->environment, importer->name, (fmi2Status)status, category, format);
}

/* Inquiry, creation and destruction */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[])
{
    (void)loggingOn;
    return (fmi2Status)set_logging((Instance *)c, "fmi2SetDebugLogging", nCategories, categories);
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn)
{
    Importer importer;

    (void)fmuResourceLocation;
    (void)visible;
    (void)loggingOn;
    memset(&importer, 0, sizeof importer);
    if (functions != NULL) {
        importer.logger = (void (*)(void))functions->logger;
        importer.environment = functions->componentEnvironment;
    }
    return instantiate(&importer, instanceName, fmuGUID, fmuType == fmi2CoSimulation ? NULL : "model exchange");
}

void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

/* Initialization, termination and reset */

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    const int status = check_phase((Instance *)c, "fmi2SetupExperiment", INSTANTIATED, "before initialization mode");

    (void)toleranceDefined; /* the step is exact: there is no error to control */
    (void)tolerance;
    if (status != OK) {
        return (fmi2Status)status;
    }
    return (fmi2Status)set_times((Instance *)c, "fmi2SetupExperiment", startTime, stopTimeDefined, stopTime);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *instance = (Instance *)c;
    const int status = check_phase(instance, "fmi2EnterInitializationMode", INSTANTIATED, "once, after fmi2SetupExperiment");

    if (status != OK) {
        return (fmi2Status)status;
    }
    if (!instance->state.start_defined) {
        return (fmi2Status)fail(instance, "fmi2EnterInitializationMode: the start time is not known; call fmi2SetupExperiment "
                                "first.");
    }
    enter_initialization(instance);
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return (fmi2Status)exit_initialization((Instance *)c, "fmi2ExitInitializationMode");
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    return (fmi2Status)terminate((Instance *)c, "fmi2Terminate");
}

fmi2Status fmi2Reset(fmi2Component c)
{
    return (fmi2Status)reset((Instance *)c);
}

/* Variables */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    return (fmi2Status)get_values((Instance *)c, "fmi2GetReal", vr, nvr, value, nvr);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    return (fmi2Status)set_values((Instance *)c, "fmi2SetReal", vr, nvr, value, nvr);
}

#define OTHER_TYPE(function, value_type) \
    fmi2Status function(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, value_type value[]) \
    { \
        (void)value; \
        return (fmi2Status)no_such_type((Instance *)c, #function, vr, nvr); \
    }

OTHER_TYPE(fmi2GetInteger, fmi2Integer)
OTHER_TYPE(fmi2GetBoolean, fmi2Boolean)
OTHER_TYPE(fmi2GetString, fmi2String)
OTHER_TYPE(fmi2SetInteger, const fmi2Integer)
OTHER_TYPE(fmi2SetBoolean, const fmi2Boolean)
OTHER_TYPE(fmi2SetString, const fmi2String)

/* Saved states */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    return (fmi2Status)get_state((Instance *)c, "fmi2GetFMUstate", FMUstate);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    return (fmi2Status)set_state((Instance *)c, "fmi2SetFMUstate", FMUstate);
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    return (fmi2Status)free_state((Instance *)c, FMUstate);
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    return (fmi2Status)serialised_size((Instance *)c, "fmi2SerializedFMUstateSize", FMUstate, size);
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    return (fmi2Status)serialise((Instance *)c, "fmi2SerializeFMUstate", FMUstate, serializedState, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate)
{
    return (fmi2Status)deserialise((Instance *)c, "fmi2DeSerializeFMUstate", serializedState, size, FMUstate);
}

/* Co-simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    return (fmi2Status)do_step((Instance *)c, "fmi2DoStep", currentCommunicationPoint, communicationStepSize);
}

/* A step is over when fmi2DoStep returns, so of the status kinds only these two have an answer. */
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    Instance *instance = (Instance *)c;

    if (instance == NULL) {
        return fmi2Error;
    }
    if (s != fmi2LastSuccessfulTime) {
        return (fmi2Status)refuse(&instance->importer, DISCARD, "fmi2GetRealStatus: no answer for the status kind %d.", (int)s);
    }
    *value = instance->state.x[X_TIME];
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    Instance *instance = (Instance *)c;

    if (instance == NULL) {
        return fmi2Error;
    }
    if (s != fmi2Terminated) {
        return (fmi2Status)refuse(&instance->importer, DISCARD, "fmi2GetBooleanStatus: no answer for the status kind %d.", (int)s);
    }
    *value = fmi2False; /* no model asks to end the simulation */
    return fmi2OK;
}

#define NO_STATUS(function, value_type) \
    fmi2Status function(fmi2Component c, const fmi2StatusKind s, value_type *value) \
    { \
        (void)value; \
        if (c == NULL) { \
            return fmi2Error; \
        } \
        return (fmi2Status)refuse(&((Instance *)c)->importer, DISCARD, "%s: no answer for the status kind %d, because no step " \
                                  "is ever pending.", #function, (int)s); \
    }

NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)

/* What the model description says is not there: present as symbols, because importers look up all of them. */

#define NOT_THERE(function, arguments, reason) \
    fmi2Status function arguments \
    { \
        return (fmi2Status)unsupported((Instance *)c, #function, reason); \
    }
#define NO_MODEL_EXCHANGE "this FMU is for co-simulation only"

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* all of what follows ignores its arguments */
#endif

NOT_THERE(fmi2CancelStep, (fmi2Component c), "no step is ever pending")
NOT_THERE(fmi2SetRealInputDerivatives, (fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
          const fmi2Real value[]), "inputs are held during a step (canInterpolateInputs is false)")
NOT_THERE(fmi2GetRealOutputDerivatives, (fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
          fmi2Real value[]), "there are no output derivatives (maxOutputDerivativeOrder is 0)")
NOT_THERE(fmi2GetDirectionalDerivative, (fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
          const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[], fmi2Real dvUnknown[]),
          "providesDirectionalDerivative is false")
NOT_THERE(fmi2EnterEventMode, (fmi2Component c), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2NewDiscreteStates, (fmi2Component c, fmi2EventInfo *eventInfo), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2EnterContinuousTimeMode, (fmi2Component c), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2CompletedIntegratorStep, (fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
          fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2SetTime, (fmi2Component c, fmi2Real time), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2SetContinuousStates, (fmi2Component c, const fmi2Real x[], size_t nx), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2GetDerivatives, (fmi2Component c, fmi2Real derivatives[], size_t nx), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2GetEventIndicators, (fmi2Component c, fmi2Real eventIndicators[], size_t ni), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2GetContinuousStates, (fmi2Component c, fmi2Real x[], size_t nx), NO_MODEL_EXCHANGE)
NOT_THERE(fmi2GetNominalsOfContinuousStates, (fmi2Component c, fmi2Real x_nominal[], size_t nx), NO_MODEL_EXCHANGE)
