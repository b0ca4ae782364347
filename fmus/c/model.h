/* The contract between one model and the two FMI wrappers.
 *
 * An instance of a model is one flat vector x of MODEL_SIZE doubles, and nothing else:
 *
 *   x[0] ... x[n - 1]   the variables that importers see, element by element, in the order of the model's description.
 *                       X_<name> is the index of a variable's first element (brackets and dots become _).
 *   x[X_TIME]           the instance's own time in seconds; the wrapper writes it, the model may read it.
 *   x[X_HIDDEN] ...     MODEL_HIDDEN doubles of state or scratch space that no importer sees; zero at the start.
 *
 * The wrapper fills x with the start values, lets importers set inputs and parameters, and saves, restores and
 * serialises the instance by copying x. So a model must:
 *
 *   1. keep everything that its next step depends on in x: no static or global variable that is written;
 *   2. allocate nothing and call nothing that can block;
 *   3. in model_initialize, compute states and outputs at the start time from inputs, parameters and time. It is
 *      called each time an output is asked for in initialization mode, and at its end, so calling it twice must give
 *      the same as calling it once;
 *   4. in model_step, go from x at time t = x[X_TIME] to x at t + h, with the inputs held. Return 0, or another
 *      number where the step cannot be done: the wrapper then reports an error with that number. A value that is not a
 *      number is no reason to refuse: NaN in an input may mean a missing measurement.
 *
 * model_config.h is written from the Python description and holds the names, start values and the token.
 */
#ifndef BAYESFTC_MODEL_H
#define BAYESFTC_MODEL_H

#include "model_config.h"

/* Hidden whatever the compiler's options: two models in one process must never find each other's functions. */
#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility push(hidden)
#endif

void model_initialize(double *x);
int model_step(double *x, double h);

#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility pop
#endif

#endif
