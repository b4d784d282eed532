/* Forces and matrices of many motions side by side, which have no directions: a level is factored as soon as its segments are known. */
#define copy(m, to, from) ((void)0)
#define move_inputs_along(m, w, arg, until, duration, left) ((void)0)
#define keep_actuation_along(m, i) ((void)0)
#define stage_along(m, w, i, t, step, before, a, v_0) NONE
#define step_along(m, h) ((void)0)
#define begin_along(m, t) ((void)0)
#define rest_along(m, w, s, t) NONE
#define record_along(m, w, arg, d, k) ((void)0)
#define weigh_along(m, by, p) ((void)0)
#define pack(w) ((void)0)

static inline void set(real *to, const real *from) { for (int r = 0; r < NB; r++) to[r] = from[r]; }

/* LU factors of a block without pivoting, in place: U with the inverses of the pivots above and on the diagonal, L (its diagonal is 1)
   below; returns where a pivot is 0 or not a number. */
static mask factor(block a) {
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

/* x becomes L^-1 x, or U^-1 x */
static inline void solve_lower(const block a, real *x) {
#pragma GCC unroll 12
  for (int k = 0; k < NB; k++) for (int r = k + 1; r < NB; r++) x[r] -= a[k][r] * x[k];
}

static inline void solve_upper(const block a, real *x) {
#pragma GCC unroll 12
  for (int k = NB - 1; k >= 0; k--) {
    x[k] *= a[k][k];
    for (int r = 0; r < k; r++) x[r] -= a[k][r] * x[k];
  }
}

/* Add what a segment's tangent, column by column, makes of the matrix, and eliminate its lower level l: of the block L U on the diagonal
   `below` becomes B U^-1 and `above` L^-1 A. */
static mask eliminate(blocks *b, int l, real (*tangent)[2 * NB], real mass) {
  real(*next)[NB] = b->diagonal[l + 1], (*below)[NB] = b->below[l + 1], (*above)[NB] = b->above[l + 1], (*lu)[NB] = b->diagonal[l];
  for (int c = 0; c < NB; c++) {
    set(next[c], tangent[NB + c] + NB);
    next[c][c] += mass;
  }
  if (!l) return NONE;
  for (int c = 0; c < NB; c++) for (int r = 0; r < NB; r++) lu[c][r] += tangent[c][r];
  mask failed = factor(lu);
#pragma GCC unroll 12
  for (int c = 0; c < NB; c++) {
    real x[NB];
    set(x, tangent[NB + c]);
    solve_lower(lu, x);
    set(above[c], x);
    set(x, tangent[c] + NB);
    for (int k = 0; k < c; k++) for (int r = 0; r < NB; r++) x[r] -= below[k][r] * lu[c][k];
    for (int r = 0; r < NB; r++) below[c][r] = x[r] * lu[c][c];
  }
  for (int c = 0; c < NB; c += 3) /* tiles that fit into registers */
    for (int r = 0; r < NB; r += 3) {
      real sum[3][3];
      for (int j = 0; j < 3; j++) for (int i = 0; i < 3; i++) sum[j][i] = next[c + j][r + i];
      for (int k = 0; k < NB; k++) for (int j = 0; j < 3; j++) for (int i = 0; i < 3; i++) sum[j][i] -= below[k][r + i] * above[c + j][k];
      for (int j = 0; j < 3; j++) for (int i = 0; i < 3; i++) next[c + j][r + i] = sum[j][i];
    }
  return failed;
}

/* Forces of all segments at w->x, w->v (w->force), rates of the edge states and, unless `matrix` is null, the factored tangent
   M / step^2 + d force / d positions of a stage; returns where factoring has failed. */
static mask forces_and_factor(work *w, real step, blocks *matrix) {
  mask failed = NONE;
  real force[2 * NB], tangent[2 * NB][2 * NB];
  for (int s = 0; s < NLEV; s++) {
    const real *arg[] = {w->x[s], w->x[s + 1], w->v[s], w->v[s + 1], w->y[s], &step, w->P[s], w->theta, w->trusted[s]};
    real *res[] = {force, w->rate[s], w->pull[s], tangent[0]};
    if (matrix) segment_tangent_lanes(arg, res);
    else segment_motion_lanes(arg, res);
    if (s) for (int i = 0; i < NB; i++) w->force[s][i] += force[i];
    set(w->force[s + 1], force + NB);
    if (matrix) failed |= eliminate(matrix, s, tangent, w->P[s][MASS] / step / step);
  }
  return matrix ? failed | factor(matrix->diagonal[NLEV]) : failed;
}

static void forces(work *w, real step, int with_tangent) { forces_and_factor(w, step, 0); }

/* Forces and the factored tangent of a stage where that is asked for; returns where it has failed. */
static mask assemble(stepper *m, work *w, real step, mask on, int all) {
  m->factors += pick(on, each(1), ZERO);
  mask failed = forces_and_factor(w, step, all ? &w->matrix : &w->spare);
  if (!all) blend(&w->matrix, &w->spare, sizeof w->spare, on);
  return failed;
}

/* x -= block times y */
static inline void subtract(const block a, const real *y, real *x) {
  real sum[2][NB] = {}; /* that do not wait for each other */
  for (int c = 0; c < NB; c++) for (int r = 0; r < NB; r++) sum[c % 2][r] += a[c][r] * y[c];
  for (int r = 0; r < NB; r++) x[r] -= sum[0][r] + sum[1][r];
}

/* Solve with the factor, in place; b has the levels 0 (left alone) … NLEV. */
static void solve(work *w, levels b) {
  const blocks *matrix = &w->matrix;
  for (int l = 1; l <= NLEV; l++) {
    if (l > 1) subtract(matrix->below[l], b[l - 1], b[l]);
    solve_lower(matrix->diagonal[l], b[l]);
  }
  for (int l = NLEV; l >= 1; l--) {
    if (l < NLEV) subtract(matrix->above[l + 1], b[l + 1], b[l]);
    solve_upper(matrix->diagonal[l], b[l]);
  }
}

/* The edges' pulls at the last evaluation are trusted from now on. */
static void trust(work *w, mask on) { blend(w->trusted, w->pull, sizeof w->pull, on); }
