/* Loops over the chain of segments, around the kernels (see kernels.py) above this text in the same unit:
   assembly, block-tridiagonal Cholesky, Newton for statics, adjoint sensitivities. statics.py is the reference twin.

   Sizes are macros: NB coordinates a level, NLEV free levels, NPROP rows of P, NDRIVEN of them changed by inputs, NU inputs,
   NEXT external force components, NPOINT point coordinates, NLEN lengths, ROWS weights of an adjoint kernel. NTHETA, the number of
   parameters, is a constant beside the kernels, and NTHETA_ROOM no less. Statuses and limits are macros too: interface.py has them.
   Level 0 is fixed.

   What grows with segments, modules or parameters lies in `work`, which is the caller's (statics_calls.c): stacks are small in threads. */

#define NVEC ((2 * NB + LANES - 1) / LANES)
#define LD (NVEC * LANES)                /* rows of a panel column, padded to whole vectors */

typedef struct {
  double x[NLEV + 1][NB], trial[NLEV + 1][NB];   /* levels */
  double P[NLEV][NPROP];                         /* properties, one row a segment */
  double force[NLEV + 1][NB], step[NLEV + 2][NB];
  double panel[NLEV + 1][NB][LD];                /* column c of level l: its diagonal block, then its coupling to l + 1 */
  double first[2 * NB * NB], second[NB * NB];
  double a[NU], level_0[NB];
  const double *theta;
  turns turns;
  struct {                                       /* of `adjoint` */
    double sum[ROWS][NTHETA_ROOM], spare[ROWS * NTHETA_ROOM], by_x[NLEV + 1][NB], by_P[ROWS][NLEV][NPROP], by_a[NU], driven[NLEV][NDRIVEN];
    vector step[NLEV + 2][NB];
  } adjoint;
  struct { double by_a[NU / 2][NU], shift[NU / 2][NLEV + 1][NB], matrix[NU / 2 * NU / 2]; } inverse; /* of `solve_together` */
} work;

static double energy(work *w, double x[][NB]) {
  double total = 0, part;
  for (int s = 0; s < NLEV; s++) {
    const double *arg[] = {x[s], x[s + 1], w->P[s], w->theta};
    double *res[] = {&part};
    segment_energy(arg, res);
    total += part;
  }
  return total;
}

/* Add the block columns of segment s (w->first, w->second) to the panels; segments come in turn. */
static inline void place(work *w, int s) {
  for (int c = 0; c < NB; c++) {
    double *lower = w->panel[s][c], *upper = w->panel[s + 1][c];
    const double *first = w->first + 2 * NB * c, *second = w->second + NB * c;
    if (s) for (int r = 0; r < NB; r++) lower[r] += first[r];
    for (int r = NB; r < 2 * NB; r++) lower[r] = first[r];
    for (int r = 0; r < NB; r++) upper[r] = second[r];
    for (int r = NB; r < LD; r++) upper[r] = 0;
  }
}

/* Energy (returned), its gradient (w->force) and panels of the stiffness, or of the convex one, at w->x. */
static inline double assemble(work *w, int convex) {
  double total = 0, part, force[2 * NB];
  memset(w->force, 0, sizeof w->force);
  for (int s = 0; s < NLEV; s++) {
    const double *arg[] = {w->x[s], w->x[s + 1], w->P[s], w->theta};
    double *res[] = {&part, force, w->first, w->second};
    if (convex) segment_convex(arg, res);
    else segment_stiffness(arg, res);
    total += part;
    for (int i = 0; i < NB; i++) { w->force[s][i] += force[i]; w->force[s + 1][i] += force[NB + i]; }
    place(w, s);
  }
  return total;
}

/* Gradient (w->force) alone. */
static void gradient(work *w) {
  double force[2 * NB];
  memset(w->force, 0, sizeof w->force);
  for (int s = 0; s < NLEV; s++) {
    const double *arg[] = {w->x[s], w->x[s + 1], w->P[s], w->theta};
    double *res[] = {force};
    segment_gradient(arg, res);
    for (int i = 0; i < NB; i++) { w->force[s][i] += force[i]; w->force[s + 1][i] += force[NB + i]; }
  }
}

static double residual(work *w) {
  double largest = 0;
  for (int l = 1; l <= NLEV; l++)
    for (int i = 0; i < NB; i++) { double f = fabs(w->force[l][i]); if (!(f <= largest)) largest = f; }
  return largest;
}

/* L D L' in place: column j of a panel becomes L's times its pivot, the diagonal entry the inverse of the pivot.
   Returns 0, or 1 where the matrix is not positive definite. */
static int factor(work *w) {
  for (int l = 1; l <= NLEV; l++) {
    double (*p)[LD] = w->panel[l], scaled[NB][NB];
#pragma GCC unroll 12
    for (int j = 0; j < NB; j++) {
      vector column[NVEC];
      memcpy(column, p[j], sizeof column);
#pragma GCC unroll 12
      for (int k = 0; k < j; k++) {
        double scale = scaled[k][j];
#pragma GCC unroll 12
        for (int v = j / LANES; v < NVEC; v++) column[v] -= scale * *(vector *)(p[k] + LANES * v);
      }
      memcpy(p[j], column, sizeof column);
      if (!(p[j][j] > 0)) return 1;
      p[j][j] = 1 / p[j][j];
      for (int r = j + 1; r < NB; r++) scaled[j][r] = p[j][r] * p[j][j];
    }
    if (l == NLEV) break;
    for (int k = 0; k < NB; k++) {
      double column[NB];
      memcpy(column, w->panel[l + 1][k], sizeof column);
#pragma GCC unroll 12
      for (int j = 0; j < NB; j++) {
        double scale = p[j][NB + k] * p[j][j];
        for (int r = 0; r < NB; r++) column[r] -= scale * p[j][NB + r];
      }
      memcpy(w->panel[l + 1][k], column, sizeof column);
    }
  }
  return 0;
}

/* Solve with the factor for LANES right-hand sides at once; b has levels 1 … NLEV and one spare. */
static void solve(work *w, vector (*b)[NB]) {
  memset(b[NLEV + 1], 0, sizeof b[0]);
  for (int l = 1; l <= NLEV; l++) {
    double (*p)[LD] = w->panel[l];
    vector *t = b[l]; /* this level and the next */
#pragma GCC unroll 12
    for (int j = 0; j < NB; j++) {
      vector y = t[j] *= p[j][j];
#pragma GCC unroll 24
      for (int r = j + 1; r < 2 * NB; r++) t[r] -= y * p[j][r];
    }
  }
  memset(b[NLEV + 1], 0, sizeof b[0]);
  for (int l = NLEV; l >= 1; l--) {
    double (*p)[LD] = w->panel[l];
    vector *t = b[l];
#pragma GCC unroll 12
    for (int j = NB - 1; j >= 0; j--) {
      vector sum = {0};
#pragma GCC unroll 24
      for (int r = j + 1; r < 2 * NB; r++) sum += p[j][r] * t[r];
      t[j] -= sum * p[j][j];
    }
  }
}

/* The Newton step -(stiffness)^-1 force, into w->step. */
static void newton_step(work *w) {
  double t[2 * NB] = {0}, (*b)[NB] = w->step;
  for (int l = 1; l <= NLEV; l++) {
    double (*p)[LD] = w->panel[l];
    for (int r = 0; r < NB; r++) { t[r] = t[NB + r] - w->force[l][r]; t[NB + r] = 0; }
#pragma GCC unroll 16
    for (int j = 0; j < NB; j++) {
      double y = b[l][j] = t[j] * p[j][j];
      for (int r = 0; r < 2 * NB; r++) t[r] -= y * p[j][r];
    }
  }
  memset(b[NLEV + 1], 0, sizeof b[0]);
  for (int l = NLEV; l >= 1; l--) {
    double (*p)[LD] = w->panel[l], coupled[NB];
    for (int j = 0; j < NB; j++) {
      coupled[j] = 0;
#pragma GCC unroll 36
      for (int r = 0; r < NB; r++) coupled[j] += p[j][NB + r] * b[l + 1][r];
    }
#pragma GCC unroll 16
    for (int j = NB - 1; j >= 0; j--) {
      double sum = coupled[j];
      for (int r = NB - 1; r > j; r--) sum += p[j][r] * b[l][r];
      b[l][j] -= sum * p[j][j];
    }
  }
}

/* Factor the stiffness at w->x, or a positive definite stand-in where it is indefinite (returns 1 then). */
static int factor_safely(work *w) {
  if (!factor(w)) return 0;
  for (double shift = 1e-6;; shift *= 100) {
    assemble(w, 1);
    for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) w->panel[l][i][i] += shift;
    if (!factor(w) || shift > 1e12) return 1;
  }
}

/* P and level 0 of the effective actuation w->a. */
static void set_properties(work *w, const double *external) {
  const double *arg[] = {w->a, external, w->theta};
  double *res[] = {w->P[0], w->level_0};
  properties(arg, res);
}

/* Effective actuation a under the commanded u. */
static void map_inputs(work *w, const double *u, double *a) {
  const double *arg[] = {u, w->theta};
  double *res[] = {a};
  input_map(arg, res);
}

/* Equilibrium from the start w->x, in place. info: iterations, residual in N, energy in J. Returns a status. */
static int settle(work *w, double tolerance, int max_iterations, double *info) {
  int status = EXHAUSTED, iteration;
  memcpy(w->x[0], w->level_0, sizeof w->level_0);
  for (iteration = 0; iteration <= max_iterations; iteration++) {
    double here = assemble(w, 0), away = residual(w), slope = 0, t = 1;
    info[1] = away; info[2] = here;
    int indefinite = factor_safely(w), found = 0;
    if (away < tolerance) { status = indefinite ? UNSTABLE : SOLVED; break; }
    if (!(away < 1e300)) { status = STALLED; break; }
    newton_step(w);
    if (!indefinite && away < PLAIN_NEWTON) {
      for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) w->x[l][i] += w->step[l][i];
      gradient(w);
      info[1] = residual(w);
      if (info[1] < tolerance) { status = SOLVED; iteration++; break; } /* stable: so was the factor a step before */
      continue;
    }
    for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) slope += w->force[l][i] * w->step[l][i];
    for (int halving = 0; halving < 40; halving++) {
      move(&w->turns, w->x, w->step, t, w->trial);
      double there = energy(w, w->trial);
      if (there <= here + 1e-4 * t * slope + ENERGY_NOISE * (1 + fabs(here))) { found = 1; break; }
      double shorter = -slope * t * t / 2 / (there - here - slope * t);
      t = shorter > 0.1 * t ? (shorter < 0.5 * t ? shorter : 0.5 * t) : 0.1 * t;
    }
    if (!found) { status = STALLED; break; }
    memcpy(w->x, w->trial, sizeof w->x);
  }
  info[0] = iteration > max_iterations ? max_iterations : iteration;
  return status;
}

/* Points in G, then lengths, at w->x. */
static void look(work *w, double *observed) {
  const double *arg[] = {w->x[0], w->theta};
  double *res[] = {observed, observed + NPOINT};
  observe(arg, res);
}

/* `sensitivity` for up to ROWS rows, with the factor at hand; `shift`, unless null, takes each row's gradient by the gradient
   of the energy, (rows, NLEV + 1, NB): how the sum moves where the network is not in equilibrium. */
static void adjoint(work *w, const double *u, int mapped, const double *external, int rows, const double *weights, double *by_u,
                    double *by_external, double *by_theta, double *shift) {
  double by_level_0[ROWS][NB] = {{0}}, kernel_P[ROWS][NPROP], pair[ROWS][2][NB];
  double (*sum)[NTHETA_ROOM] = w->adjoint.sum, *spare = w->adjoint.spare, (*by_x)[NB] = w->adjoint.by_x;
  double (*by_P)[NLEV][NPROP] = w->adjoint.by_P, (*driven)[NDRIVEN] = w->adjoint.driven, *by_a = w->adjoint.by_a;
  vector (*step)[NB] = w->adjoint.step;
  memset(sum, 0, sizeof w->adjoint.sum);
  memset(step, 0, sizeof w->adjoint.step);
  for (int row = 0; row < rows; row++) {
    const double *weight = weights + row * (NPOINT + NLEN), *arg[] = {w->x[0], w->theta, weight, weight + NPOINT};
    double *res[] = {by_x[0], sum[row]};
    observe_adjoint(arg, res);
    memcpy(by_level_0[row], by_x[0], sizeof by_x[0]);
    for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) step[l][i][row] = -by_x[l][i];
  }
  solve(w, step);
  for (int row = 0; row < rows; row++)
    for (int c = 0; c < NB; c++) for (int r = 0; r < NB; r++) by_level_0[row][c] += w->panel[0][c][NB + r] * step[1][r][row];
  memset(step[0], 0, sizeof step[0]);
  if (shift)
    for (int row = 0; row < rows; row++) for (int l = 0; l <= NLEV; l++) for (int i = 0; i < NB; i++) *shift++ = step[l][i][row];
  int count = by_theta ? NPROP : NDRIVEN;
  for (int s = 0; s < NLEV; s++) {
    for (int row = 0; row < ROWS; row++) for (int i = 0; i < NB; i++) { pair[row][0][i] = step[s][i][row]; pair[row][1][i] = step[s + 1][i][row]; }
    const double *arg[] = {w->x[s], w->x[s + 1], w->P[s], w->theta, pair[0][0]};
    double *res[] = {kernel_P[0], spare};
    if (by_theta) segment_theta_adjoint(arg, res);
    else segment_adjoint(arg, res);
    for (int row = 0; row < rows; row++) {
      memcpy(by_P[row][0] + s * count, kernel_P[0] + row * count, count * sizeof(double));
      if (by_theta) for (int k = 0; k < NTHETA; k++) sum[row][k] += spare[row * NTHETA + k];
    }
  }
  for (int row = 0; row < rows; row++) {
    if (by_theta) {
      const double *arg[] = {w->a, external, w->theta, by_P[row][0], by_level_0[row]};
      double *res[] = {by_theta + row * NTHETA};
      properties_theta_adjoint(arg, res);
      for (int s = 0; s < NLEV; s++) for (int k = 0; k < NDRIVEN; k++) driven[s][k] = by_P[row][s][DRIVEN[k]];
    } else memcpy(driven, by_P[row], sizeof w->adjoint.driven);
    const double *arg[] = {w->a, external, w->theta, driven[0]};
    double *res[] = {by_a, by_external + row * NEXT};
    properties_adjoint(arg, res);
    const double *arg_map[] = {u, w->theta, by_a};
    double *res_map[] = {by_u + row * NU, spare};
    if (mapped) memcpy(by_u + row * NU, by_a, sizeof w->adjoint.by_a);
    else {
      input_map_adjoint(arg_map, res_map);
      for (int k = 0; k < NTHETA; k++) sum[row][k] += spare[k];
    }
    if (by_theta) for (int k = 0; k < NTHETA; k++) by_theta[row * NTHETA + k] += sum[row][k];
  }
}
