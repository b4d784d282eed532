/* One step of the predictive controller in C; mpc/python_step.py, estimation/, actuation/ and mpc/prediction.py are the twin, names are
   theirs.

   Sizes are macros: NA actuators, NP points, NQ modes, NSHAPE shapes, NCO free coordinates, NLEVELS coordinates of all levels, STAGES and
   PREVIEW of the horizon, WINDOW of the slope, KEPT operating points. `settings` and `outcome` are declared above this text, doubles in
   the order in which the caller has them. */
#include <math.h>
#include <stddef.h>
#include <string.h>
#include <time.h>

#define NX (2 * NQ)
#define NY (3 * NP)
#define NS (NX + 4 * NA + NY)      /* the filter's state: motion, forces, strength, friction, hysteresis, biases */
#define NM (NX + 4 * NA)           /* what the motion depends on */
#define NV (STAGES * NA)
#define NZ (NX + NA)
#define PERIODS 2
#define SENT 64
#define FORCE NX
#define STRENGTH (NX + NA)
#define FRICTION (NX + 2 * NA)
#define HYSTERESIS (NX + 3 * NA)
#define BIAS (NX + 4 * NA)
enum { SOLVED, INFEASIBLE, ITERATIONS, NOT_FINITE, NOT_CONVEX, INEXACT, LATE };

typedef int linearise(const double *x, const double *u, int mapped, const double *external, const double *theta, const double *masses,
                      const double *by, int sweeps, double near, double *basis, double *values, double *damping, double *drive,
                      double *observed, double *gain);

/* What does not change: the reference row by row, and the network. */
typedef struct {
  long rows;
  const double *levels, *inputs, *loads, *forces, *lengths, *tips, *points; /* (rows, …) */
  const int *mapped;
  const double *theta, *masses, *by, *basis, *values; /* basis and values of the first row */
  const double *free; /* theta without lags and delays */
} course;

typedef struct {
  long row;
  double basis[NCO][NSHAPE], values[NSHAPE], damping[NQ][NQ], drive[NQ][NA], observe[NY][NQ], gain[NY][NA];
  double A[NX][NX], start[NX][NQ], end[NX][NQ], by_start[NX][NA], by_end[NX][NA];
  const double *levels, *forces, *points;
  long before; /* row of the point from which `turn` and `shift` are known, or -1 */
  double turn[NQ][NQ], shift[NQ];
} operating;

typedef struct { double pressure[NA], tension[NA]; } devices;
typedef struct {
  devices now, told, offset; /* offset: of what measures them */
  double rate[NA], late, weight, spread;
  double share[2][NA], path[NA], rise[NA], turned[NA], offset_path[NA], misfit[NA], covariance[3][3][NA], slope[2][NA]; /* actuation/regulator_lags.py */
  double off[NA], noise[NA]; /* readings above what lags and offset explain, NaN before the first one; noise of the monitors */
  double factor, nearest_factor, factor_variance, common[2][2], by_factor[NA]; /* mpc/lag_factor.py; common: shares with the factors for
    lags and lead */
  double entered[2 * NA], memory[MEMORY + 1], extra[NA]; /* what the model's effects make of pressures and tensions, in N */
} actuators;

typedef struct {
  const operating *at;
  double mean[NS], covariance[NS][NS], direction[NA], deviation[NA], turning[NA], tension[NA], noise, by_factor[NS];
  int begun, outlying[NP], tip_missing;
} filter;

typedef struct {
  double cross[NS][NY], S[NY][NY]; /* of the state and the innovation, of the innovation */
  double off[NY];                  /* innovation */
  int good[NP];                    /* points that were taken */
} correction;

typedef struct {
  const operating *at;
  double A[NX][NX], start[NX][NA], end[NX][NA], pushed[STAGES][NX], forces[PREVIEW + 1][NA], dynamic[PREVIEW][NA];
  double Q[NQ][NQ], value[NZ][NZ], rate[NQ], undo[NA][3], speed;
} horizon;

typedef struct {
  int status, active[2 * NV], count; /* number of a row, negative - 1 at its lower bound */
  double inverse[NV][NV], length[2 * NV], scale, lower[NV + 1][NV + 1], multiplier[NV];
} program;

typedef struct {
  settings set;
  course way;
  linearise *modal;
  operating kept[KEPT], *newest, last;
  filter filters[2];
  actuators acts[2];
  correction to_do;
  horizon beyond;
  program best;
  struct { double at; devices command; } sent[SENT];
  int sents, ahead, declared, now, ready, corrected, planned_there, plan_there;
  long row, ready_row, samples, noted;
  double zero, turn[NQ][NQ], shift[NQ], directions[KEPT][NA], courses[PREVIEW][NA], foreseen[PREVIEW][NA], factor[PREVIEW][NA];
  double slow[NA], extra[STAGES][NA], planned[STAGES][NA], plan[STAGES][NA], hessian[NV][NV];
  double seen[NOISE_WINDOW][NY], measured;
  outcome out;
} step;

static inline int is_blind(const settings *s, const filter *f) { return f->tip_missing > s->most_rejections; }
static inline double least(double a, double b) { return a < b ? a : b; }
static inline double most(double a, double b) { return a > b ? a : b; }
static inline double within(double x, double low, double high) { return least(most(x, low), high); }
static inline long at_row(const step *o, long row) { return row < 0 ? 0 : row >= o->way.rows ? o->way.rows - 1 : row; }

/* Direction after a change (Dahl). */
static inline double dahl_step(double direction, double change, double distance) {
  double sign = change > 0 ? 1 : -1;
  return change == 0 ? direction : sign + (direction - sign) * exp(-fabs(change) / distance);
}

/* c = keep c + a b, (n, k) by (k, m); element (i, p) of a is a[i * ra + p * ca]. */
static inline __attribute__((always_inline)) void times(int n, int k, int m, const double *restrict a, int ra, int ca,
                                                        const double *restrict b, int rb, double *restrict c, int rc, double keep) {
  for (int i = 0; i < n; i++) {
    double *restrict to = c + i * rc;
    const double *by = a + i * ra;
    if (keep == 0) for (int j = 0; j < m; j++) to[j] = 0;
    else if (keep != 1) for (int j = 0; j < m; j++) to[j] *= keep;
    int p = 0;
    for (; p + 4 <= k; p += 4) {
      double s = by[p * ca], t = by[(p + 1) * ca], u = by[(p + 2) * ca], v = by[(p + 3) * ca];
      const double *e = b + p * rb, *f = e + rb, *g = f + rb, *h = g + rb;
      for (int j = 0; j < m; j++) to[j] += s * e[j] + t * f[j] + u * g[j] + v * h[j];
    }
    for (; p < k; p++) { double s = by[p * ca]; const double *e = b + p * rb; for (int j = 0; j < m; j++) to[j] += s * e[j]; }
  }
}
#define WIDTH(a) (sizeof *(a) / sizeof(double))
#define TIMES(n, k, m, a, b, c, keep) times(n, k, m, (a)[0], WIDTH(a), 1, (b)[0], WIDTH(b), (c)[0], WIDTH(c), keep)
/* of a transposed: */
#define TIMES_BACK(n, k, m, a, b, c, keep) times(n, k, m, (a)[0], 1, WIDTH(a), (b)[0], WIDTH(b), (c)[0], WIDTH(c), keep)

/* Upper factor of a symmetric matrix in place, rows of which go on `stride`; returns 1 where a pivot is not above `smallest`. What is
   left of the diagonal is destroyed. */
static int upper(int n, double *a, int stride, double smallest) {
  for (int k = 0; k < n; k += 4) {
    int end = k + 4 < n ? k + 4 : n;
    for (int r = k; r < end; r++) {
      double *row = a + r * stride;
      for (int i = k; i < r; i++) { double s = a[i * stride + r], *by = a + i * stride; for (int j = r; j < n; j++) row[j] -= s * by[j]; }
      if (!(row[r] > smallest)) return 1;
      double inverse = 1 / sqrt(row[r]);
      for (int j = r; j < n; j++) row[j] *= inverse;
    }
    if (end - k < 4) break;
    const double *restrict b = a + k * stride, *restrict c = b + stride, *restrict d = c + stride, *restrict e = d + stride;
    int r = end;
    for (; r + 2 <= n; r += 2) {
      double *restrict row = a + r * stride, *restrict next = row + stride, s = b[r], t = c[r], u = d[r], v = e[r];
      double w = b[r + 1], x = c[r + 1], y = d[r + 1], z = e[r + 1];
      for (int j = r; j < n; j++) {
        row[j] -= s * b[j] + t * c[j] + u * d[j] + v * e[j];
        next[j] -= w * b[j] + x * c[j] + y * d[j] + z * e[j];
      }
    }
    for (; r < n; r++) a[r * stride + r] -= b[r] * b[r] + c[r] * c[r] + d[r] * d[r] + e[r] * e[r];
  }
  return 0;
}

/* Solves with that factor for m right-hand sides in place, rows of which go on `stride`; half: only with its transpose. */
static void backed(int n, const double *a, int ra, int m, double *b, int stride, int half) {
  for (int i = 0; i < n; i++) {
    for (int k = 0; k < i; k++) { double s = a[k * ra + i]; for (int j = 0; j < m; j++) b[i * stride + j] -= s * b[k * stride + j]; }
    for (int j = 0; j < m; j++) b[i * stride + j] /= a[i * ra + i];
  }
  if (half) return;
  for (int i = n - 1; i >= 0; i--) {
    for (int k = i + 1; k < n; k++) { double s = a[i * ra + k]; for (int j = 0; j < m; j++) b[i * stride + j] -= s * b[k * stride + j]; }
    for (int j = 0; j < m; j++) b[i * stride + j] /= a[i * ra + i];
  }
}
