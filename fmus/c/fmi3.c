/* FMI 3.0 for co-simulation around any model that keeps the contract of model.h. */
#include "fmi3Functions.h"
#include "instance.h"

/* instance.h returns plain numbers for both standards: stop the compiler where they would mean something else. */
typedef char the_status_values_agree[(int)fmi3OK == OK && (int)fmi3Warning == WARNING && (int)fmi3Discard == DISCARD
                                     && (int)fmi3Error == ERROR ? 1 : -1];

static void emit(const Importer *importer, int status, const char *category, const char *line)
{
    ((fmi3LogMessageCallback)importer->logger)(importer->environment, (fmi3Status)status, category, line);
}

/* Inquiry, creation and destruction */

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories, const fmi3String categories[])
{
    (void)loggingOn;
    return (fmi3Status)set_logging((Instance *)instance, "fmi3SetDebugLogging", nCategories, categories);
}

static fmi3Instance start(fmi3String name, fmi3String token, const char *obstacle, fmi3InstanceEnvironment environment,
                          fmi3LogMessageCallback logger)
{
    Importer importer;

    memset(&importer, 0, sizeof importer);
    importer.logger = (void (*)(void))logger;
    importer.environment = environment;
    return instantiate(&importer, name, token, obstacle);
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
    fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)earlyReturnAllowed; /* allowed, and never done */
    (void)requiredIntermediateVariables;
    (void)intermediateUpdate;
    return start(instanceName, instantiationToken,
                 eventModeUsed ? "event mode"
                 : nRequiredIntermediateVariables > 0 ? "an intermediate update" : NULL,
                 instanceEnvironment, logMessage);
}

fmi3Instance fmi3InstantiateModelExchange(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage)
{
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    return start(instanceName, instantiationToken, "model exchange", instanceEnvironment, logMessage);
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
    fmi3LockPreemptionCallback lockPreemption, fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    return start(instanceName, instantiationToken, "scheduled execution", instanceEnvironment, logMessage);
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

/* Initialization, termination and reset */

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    int status = check_phase((Instance *)instance, "fmi3EnterInitializationMode", INSTANTIATED, "once, after instantiation");

    (void)toleranceDefined; /* the step is exact: there is no error to control */
    (void)tolerance;
    if (status == OK) {
        status = set_times((Instance *)instance, "fmi3EnterInitializationMode", startTime, stopTimeDefined, stopTime);
    }
    if (status == OK) {
        enter_initialization((Instance *)instance);
    }
    return (fmi3Status)status;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return (fmi3Status)exit_initialization((Instance *)instance, "fmi3ExitInitializationMode");
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return (fmi3Status)terminate((Instance *)instance, "fmi3Terminate");
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    return (fmi3Status)reset((Instance *)instance);
}

/* Variables */

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues)
{
    return (fmi3Status)get_values((Instance *)instance, "fmi3GetFloat64", valueReferences, nValueReferences, values, nValues);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues)
{
    return (fmi3Status)set_values((Instance *)instance, "fmi3SetFloat64", valueReferences, nValueReferences, values, nValues);
}

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* what is not there ignores its arguments */
#endif

#define OTHER_TYPE(function, ...) \
    fmi3Status function(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, __VA_ARGS__) \
    { \
        return (fmi3Status)no_such_type((Instance *)instance, #function, valueReferences, nValueReferences); \
    }

OTHER_TYPE(fmi3GetFloat32, fmi3Float32 values[], size_t nValues)
OTHER_TYPE(fmi3GetInt8, fmi3Int8 values[], size_t nValues)
OTHER_TYPE(fmi3GetUInt8, fmi3UInt8 values[], size_t nValues)
OTHER_TYPE(fmi3GetInt16, fmi3Int16 values[], size_t nValues)
OTHER_TYPE(fmi3GetUInt16, fmi3UInt16 values[], size_t nValues)
OTHER_TYPE(fmi3GetInt32, fmi3Int32 values[], size_t nValues)
OTHER_TYPE(fmi3GetUInt32, fmi3UInt32 values[], size_t nValues)
OTHER_TYPE(fmi3GetInt64, fmi3Int64 values[], size_t nValues)
OTHER_TYPE(fmi3GetUInt64, fmi3UInt64 values[], size_t nValues)
OTHER_TYPE(fmi3GetBoolean, fmi3Boolean values[], size_t nValues)
OTHER_TYPE(fmi3GetString, fmi3String values[], size_t nValues)
OTHER_TYPE(fmi3GetBinary, size_t valueSizes[], fmi3Binary values[], size_t nValues)
OTHER_TYPE(fmi3GetClock, fmi3Clock values[])
OTHER_TYPE(fmi3SetFloat32, const fmi3Float32 values[], size_t nValues)
OTHER_TYPE(fmi3SetInt8, const fmi3Int8 values[], size_t nValues)
OTHER_TYPE(fmi3SetUInt8, const fmi3UInt8 values[], size_t nValues)
OTHER_TYPE(fmi3SetInt16, const fmi3Int16 values[], size_t nValues)
OTHER_TYPE(fmi3SetUInt16, const fmi3UInt16 values[], size_t nValues)
OTHER_TYPE(fmi3SetInt32, const fmi3Int32 values[], size_t nValues)
OTHER_TYPE(fmi3SetUInt32, const fmi3UInt32 values[], size_t nValues)
OTHER_TYPE(fmi3SetInt64, const fmi3Int64 values[], size_t nValues)
OTHER_TYPE(fmi3SetUInt64, const fmi3UInt64 values[], size_t nValues)
OTHER_TYPE(fmi3SetBoolean, const fmi3Boolean values[], size_t nValues)
OTHER_TYPE(fmi3SetString, const fmi3String values[], size_t nValues)
OTHER_TYPE(fmi3SetBinary, const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
OTHER_TYPE(fmi3SetClock, const fmi3Clock values[])

/* Saved states */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return (fmi3Status)get_state((Instance *)instance, "fmi3GetFMUState", FMUState);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    return (fmi3Status)set_state((Instance *)instance, "fmi3SetFMUState", FMUState);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    return (fmi3Status)free_state((Instance *)instance, FMUState);
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    return (fmi3Status)serialised_size((Instance *)instance, "fmi3SerializedFMUStateSize", FMUState, size);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    return (fmi3Status)serialise((Instance *)instance, "fmi3SerializeFMUState", FMUState, serializedState, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size, fmi3FMUState *FMUState)
{
    return (fmi3Status)deserialise((Instance *)instance, "fmi3DeserializeFMUState", serializedState, size, FMUState);
}

/* Co-simulation */

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    const int status = do_step((Instance *)instance, "fmi3DoStep", currentCommunicationPoint, communicationStepSize);

    if (eventHandlingNeeded != NULL) {
        *eventHandlingNeeded = fmi3False;
    }
    if (terminateSimulation != NULL) {
        *terminateSimulation = fmi3False;
    }
    if (earlyReturn != NULL) {
        *earlyReturn = fmi3False;
    }
    if (lastSuccessfulTime != NULL && instance != NULL) {
        *lastSuccessfulTime = ((Instance *)instance)->state.x[X_TIME];
    }
    return (fmi3Status)status;
}

/* What the model description says is not there: present as symbols, because importers look up all of them. */

#define NOT_THERE(function, reason, ...) \
    fmi3Status function(__VA_ARGS__) \
    { \
        return (fmi3Status)unsupported((Instance *)instance, #function, reason); \
    }
#define NO_MODEL_EXCHANGE "this FMU is for co-simulation only"
#define NO_EVENTS "hasEventMode is false"
#define NO_CLOCKS "there are no clocks"
#define NO_DEPENDENCIES "providesPerElementDependencies is false; see the model structure"
#define NO_STRUCTURE "there are no structural parameters"

NOT_THERE(fmi3EnterEventMode, NO_EVENTS, fmi3Instance instance)
NOT_THERE(fmi3EnterStepMode, NO_EVENTS, fmi3Instance instance)
NOT_THERE(fmi3EvaluateDiscreteStates, NO_EVENTS, fmi3Instance instance)
NOT_THERE(fmi3UpdateDiscreteStates, NO_EVENTS, fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
          fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
          fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)
NOT_THERE(fmi3EnterConfigurationMode, NO_STRUCTURE, fmi3Instance instance)
NOT_THERE(fmi3ExitConfigurationMode, NO_STRUCTURE, fmi3Instance instance)
NOT_THERE(fmi3GetNumberOfVariableDependencies, NO_DEPENDENCIES, fmi3Instance instance, fmi3ValueReference valueReference,
          size_t *nDependencies)
NOT_THERE(fmi3GetVariableDependencies, NO_DEPENDENCIES, fmi3Instance instance, fmi3ValueReference dependent,
          size_t elementIndicesOfDependent[], fmi3ValueReference independents[], size_t elementIndicesOfIndependents[],
          fmi3DependencyKind dependencyKinds[], size_t nDependencies)
NOT_THERE(fmi3GetDirectionalDerivative, "providesDirectionalDerivatives is false", fmi3Instance instance,
          const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
          const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
NOT_THERE(fmi3GetAdjointDerivative, "providesAdjointDerivatives is false", fmi3Instance instance,
          const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
          const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
NOT_THERE(fmi3GetOutputDerivatives, "there are no output derivatives (maxOutputDerivativeOrder is 0)", fmi3Instance instance,
          const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
          size_t nValues)
NOT_THERE(fmi3GetIntervalDecimal, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
NOT_THERE(fmi3GetIntervalFraction, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
NOT_THERE(fmi3GetShiftDecimal, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3Float64 shifts[])
NOT_THERE(fmi3GetShiftFraction, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
NOT_THERE(fmi3SetIntervalDecimal, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3Float64 intervals[])
NOT_THERE(fmi3SetIntervalFraction, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NOT_THERE(fmi3SetShiftDecimal, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3Float64 shifts[])
NOT_THERE(fmi3SetShiftFraction, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
NOT_THERE(fmi3ActivateModelPartition, NO_CLOCKS, fmi3Instance instance, fmi3ValueReference clockReference,
          fmi3Float64 activationTime)
NOT_THERE(fmi3EnterContinuousTimeMode, NO_MODEL_EXCHANGE, fmi3Instance instance)
NOT_THERE(fmi3CompletedIntegratorStep, NO_MODEL_EXCHANGE, fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
          fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
NOT_THERE(fmi3SetTime, NO_MODEL_EXCHANGE, fmi3Instance instance, fmi3Float64 time)
NOT_THERE(fmi3SetContinuousStates, NO_MODEL_EXCHANGE, fmi3Instance instance, const fmi3Float64 continuousStates[],
          size_t nContinuousStates)
NOT_THERE(fmi3GetContinuousStateDerivatives, NO_MODEL_EXCHANGE, fmi3Instance instance, fmi3Float64 derivatives[],
          size_t nContinuousStates)
NOT_THERE(fmi3GetEventIndicators, NO_MODEL_EXCHANGE, fmi3Instance instance, fmi3Float64 eventIndicators[],
          size_t nEventIndicators)
NOT_THERE(fmi3GetContinuousStates, NO_MODEL_EXCHANGE, fmi3Instance instance, fmi3Float64 continuousStates[],
          size_t nContinuousStates)
NOT_THERE(fmi3GetNominalsOfContinuousStates, NO_MODEL_EXCHANGE, fmi3Instance instance, fmi3Float64 nominals[],
          size_t nContinuousStates)
NOT_THERE(fmi3GetNumberOfEventIndicators, NO_MODEL_EXCHANGE, fmi3Instance instance, size_t *nEventIndicators)
NOT_THERE(fmi3GetNumberOfContinuousStates, NO_MODEL_EXCHANGE, fmi3Instance instance, size_t *nContinuousStates)
