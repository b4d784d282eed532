/* Numbers of one motion, or (MANY) of as many motions as a vector has lanes. What is written with `real` goes for both. A mask has all
   bits of a motion set, or none. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if MANY
typedef vector real;
typedef long long mask __attribute__((vector_size(8 * LANES)));
#define WIDTH LANES
#define LANE(value, lane) (value)[lane]
#define WHERE(comparison) ((mask)(comparison))
#define CALL(kernel, w, arg, res) kernel##_lanes(arg, res)
static inline int any(mask m) { long long all = 0; for (int lane = 0; lane < WIDTH; lane++) all |= m[lane]; return all != 0; }
static inline real pick(mask m, real a, real b) { return (real)((m & (mask)a) | (~m & (mask)b)); }
static inline real absolute(real x) { return (real)((mask)x & ((mask){0} + 0x7fffffffffffffff)); }
static inline real root(real x) { return lanes_sqrt(x); }
#else
typedef double real;
typedef long long mask;
#define WIDTH 1
#define LANE(value, lane) (value)
#define WHERE(comparison) (-(mask)(comparison))
#define CALL(kernel, w, arg, res) run(kernel, w, arg, res)
static inline int any(mask m) { return m != 0; }
static inline real pick(mask m, real a, real b) { return m ? a : b; }
static inline real absolute(real x) { return fabs(x); }
static inline real root(real x) { return sqrt(x); }
#endif
#define ZERO ((real){0})
#define NONE ((mask){0})
static inline real each(double x) { return ZERO + x; }
static inline real larger(real a, real b) { return pick(WHERE(a > b), a, b); }

/* Copies numbers where the mask is set. */
static void blend(void *to, const void *from, size_t bytes, mask where) {
  if (!any(where)) return;
  real *left = to;
  const real *right = from;
  for (size_t k = 0; k < bytes / sizeof(real); k++) left[k] = pick(where, right[k], left[k]);
}
