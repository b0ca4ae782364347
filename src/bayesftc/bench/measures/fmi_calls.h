/* What the loops in C call: functions of an FMU for co-simulation (FMI 2), and what its caller bears. */
#include <stddef.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef int (*Get)(void *, const unsigned int *, size_t, double *);
typedef int (*Set)(void *, const unsigned int *, size_t, const double *);
typedef int (*Step)(void *, double, double, int);

enum { WARNING = 1 };
