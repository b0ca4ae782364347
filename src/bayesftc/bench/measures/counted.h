/* Put before exported C compiled as C++: numbers that count what is done with them. */
#include <cmath>
#include <cstdint>
#include <cstddef>

struct Counted;
static long operations, functions;

struct Counted {
    double value;
    Counted() = default;
    template <class Number> Counted(Number x) : value(static_cast<double>(x)) {}
    explicit operator std::int64_t() const { return static_cast<std::int64_t>(value); }
    Counted operator-() const { return Counted(-value); }
    Counted &operator+=(Counted b) { ++operations; value += b.value; return *this; }
};

#define ARITHMETIC(sign) \
    static inline Counted operator sign(Counted a, Counted b) { ++operations; return Counted(a.value sign b.value); }
ARITHMETIC(+)
ARITHMETIC(-)
ARITHMETIC(*)
ARITHMETIC(/)

#define COMPARISON(sign) \
    static inline bool operator sign(Counted a, Counted b) { ++operations; return a.value sign b.value; }
COMPARISON(<)
COMPARISON(<=)
COMPARISON(>)
COMPARISON(>=)
COMPARISON(==)
COMPARISON(!=)

#define FUNCTION(name) \
    static inline Counted name(Counted x) { ++functions; return Counted(std::name(x.value)); }
FUNCTION(sqrt)
FUNCTION(exp)
FUNCTION(log)
FUNCTION(sin)
FUNCTION(cos)
FUNCTION(floor)
FUNCTION(fabs)

#define double Counted
