/* Another C library: its functions have other last digits, by one unit, where the result has many digits. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

static double other(double y)
{
    uint64_t bits;

    memcpy(&bits, &y, sizeof bits);
    if (fabs(y) > 1e-290 && fabs(y) < 1e290 && (bits & 0xffff) != 0) {
        ++bits;
        memcpy(&y, &bits, sizeof bits);
    }
    return y;
}

#define OF_ONE(function) \
    double function(double x) \
    { \
        return other(((double (*)(double))dlsym(RTLD_NEXT, #function))(x)); \
    }
#define OF_TWO(function) \
    double function(double x, double y) \
    { \
        return other(((double (*)(double, double))dlsym(RTLD_NEXT, #function))(x, y)); \
    }

OF_ONE(exp) OF_ONE(exp2) OF_ONE(expm1) OF_ONE(log) OF_ONE(log2) OF_ONE(log10) OF_ONE(log1p) OF_ONE(sin) OF_ONE(cos)
OF_ONE(tan) OF_ONE(asin) OF_ONE(acos) OF_ONE(atan) OF_ONE(sinh) OF_ONE(cosh) OF_ONE(tanh) OF_ONE(cbrt) OF_ONE(erf)
OF_ONE(erfc) OF_ONE(lgamma) OF_ONE(tgamma) OF_TWO(pow) OF_TWO(atan2) OF_TWO(hypot)
