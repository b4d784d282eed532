/* Forces and matrices of many motions side by side, which have no directions. A segment's tangent, columns of the lower
   and the upper level, is the front in which its lower level is eliminated; what is left for the upper one goes on to the next front. */
#define weigh_along(m, by, p) ((void)0)
#define pack(w) ((void)0)
#define know_time(w) ((void)0)

typedef real (*corner)[2 * NB]; /* a block within a front, column by column */
static inline corner lower(front f) { return f; }                          /* of the lower level: L U, with the inverses of U's pivots */
static inline corner below(front f) { return (corner)(f[0] + NB); }        /* of the upper level's equations: B U^-1 */
static inline corner above(front f) { return f + NB; }                     /* of the upper level in the lower one's equations: L^-1 A */
static inline corner upper(front f) { return (corner)(f[NB] + NB); }

static inline void set(real *to, const real *from) { for (int r = 0; r < NB; r++) to[r] = from[r]; }

/* x becomes L^-1 x, or U^-1 x */
static inline void solve_lower(const corner a, real *x) {
#pragma GCC unroll 12
  for (int k = 0; k < NB; k++) for (int r = k + 1; r < NB; r++) x[r] -= a[k][r] * x[k];
}

static inline void solve_upper(const corner a, real *x) {
#pragma GCC unroll 12
  for (int k = NB - 1; k >= 0; k--) {
    x[k] *= a[k][k];
    for (int r = 0; r < k; r++) x[r] -= a[k][r] * x[k];
  }
}

/* LU factors of a block without pivoting, in place (matrices are positive definite up to the small asymmetry of damping on turning
   edges); returns where a pivot is 0 or not a number. */
static mask factor(corner a) {
  mask failed = NONE;
#pragma GCC unroll 12
  for (int c = 0; c < NB; c++) {
    real x[NB];
    set(x, a[c]);
#pragma GCC unroll 12
    for (int k = 0; k < c; k++) for (int r = k + 1; r < NB; r++) x[r] -= a[k][r] * x[k];
    failed |= ~WHERE(absolute(x[c]) > 0);
    x[c] = 1 / x[c];
    for (int r = c + 1; r < NB; r++) x[r] *= x[c];
    set(a[c], x);
  }
  return failed;
}

/* Add to a level's block what the segment under it leaves, and the mass; factor it. */
static mask finish(corner block, const corner under, real mass) {
  for (int c = 0; c < NB; c++) {
    if (under) for (int r = 0; r < NB; r++) block[c][r] += under[c][r];
    block[c][c] += mass;
  }
  return factor(block);
}

/* Eliminate the lower level of a front, whose block is factored. */
static void eliminate(front f) {
  const corner lu = lower(f), b = below(f), a = above(f), rest = upper(f);
#pragma GCC unroll 12
  for (int c = 0; c < NB; c++) {
    real x[NB];
    set(x, a[c]);
    solve_lower(lu, x);
    set(a[c], x);
    set(x, b[c]);
    for (int k = 0; k < c; k++) for (int r = 0; r < NB; r++) x[r] -= b[k][r] * lu[c][k];
    for (int r = 0; r < NB; r++) b[c][r] = x[r] * lu[c][c];
  }
  for (int c = 0; c < NB; c += 3) /* tiles that fit into registers */
    for (int r = 0; r < NB; r += 3) {
      real sum[3][3];
      for (int j = 0; j < 3; j++) for (int i = 0; i < 3; i++) sum[j][i] = rest[c + j][r + i];
      for (int k = 0; k < NB; k++) for (int j = 0; j < 3; j++) for (int i = 0; i < 3; i++) sum[j][i] -= b[k][r + i] * a[c + j][k];
      for (int j = 0; j < 3; j++) for (int i = 0; i < 3; i++) rest[c + j][r + i] = sum[j][i];
    }
}

/* Forces of all segments at w->x, w->v (w->force), rates of the edge states and, unless `f` is null, the factored tangent
   M / step^2 + d force / d positions of a stage; returns where factoring has failed. */
static mask forces_and_factor(work *w, real step, front *f) {
  mask failed = NONE;
  real force[2 * NB];
  for (int s = 0; s < NLEV; s++) {
    const real *arg[] = {w->x[s], w->x[s + 1], w->v[s], w->v[s + 1], w->y[s], &step, w->P[s], w->theta, w->trusted[s]};
    real *res[] = {force, w->rate[s], w->pull[s], f ? f[s][0] : 0};
    if (f) segment_tangent_lanes(arg, res);
    else segment_motion_lanes(arg, res);
    if (s) for (int i = 0; i < NB; i++) w->force[s][i] += force[i];
    set(w->force[s + 1], force + NB);
    if (!f || !s) continue;
    failed |= finish(lower(f[s]), upper(f[s - 1]), w->P[s - 1][MASS] / step / step);
    eliminate(f[s]);
  }
  return f ? failed | finish(upper(f[NLEV - 1]), 0, w->P[NLEV - 1][MASS] / step / step) : failed;
}

static void forces(work *w, real step, int with_tangent) { forces_and_factor(w, step, 0); }

/* Forces and the factored tangent of a stage where that is asked for; returns where it has failed. */
static mask assemble(stepper *m, work *w, real step, mask on, int all) {
  m->factors += pick(on, each(1), ZERO);
  mask failed = forces_and_factor(w, step, all ? w->matrix : w->spare);
  if (!all) blend(w->matrix, w->spare, sizeof w->matrix, on);
  return failed;
}

/* x -= block times y */
static void subtract(const corner a, const real *y, real *x) {
  real sum[2][NB] = {}; /* that do not wait for each other */
  for (int c = 0; c < NB; c++) for (int r = 0; r < NB; r++) sum[c % 2][r] += a[c][r] * y[c];
  for (int r = 0; r < NB; r++) x[r] -= sum[0][r] + sum[1][r];
}

/* Solve with the factor, in place; b has the levels 0 (left alone) … NLEV. */
static void solve(work *w, levels b) {
  front *f = w->matrix;
  for (int l = 1; l <= NLEV; l++) {
    if (l > 1) subtract(below(f[l - 1]), b[l - 1], b[l]);
    solve_lower(l < NLEV ? lower(f[l]) : upper(f[l - 1]), b[l]);
  }
  for (int l = NLEV; l >= 1; l--) {
    if (l < NLEV) subtract(above(f[l]), b[l + 1], b[l]);
    solve_upper(l < NLEV ? lower(f[l]) : upper(f[l - 1]), b[l]);
  }
}

/* The edges' pulls at the last evaluation are trusted from now on. */
static void trust(work *w, mask on) { blend(w->trusted, w->pull, sizeof w->pull, on); }
