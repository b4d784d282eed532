/* The quadratic program in the tensions: bounds of each and of its change from stage to stage.

   With x = V u + free, V = scale (upper factor of H)^-1, it is the least |u|² within rows of length 1. A dual active-set method goes from
   the rows that were active before (Goldfarb, Idnani, Mathematical Programming 27, 1983; Arnström, Bemporad, Axehill, IEEE TAC 67(8),
   2022), with a Cholesky factor of the active rows' products, ready before the sample. Row k < NV is x's, row NV + k that of its change
   from the stage before, which for the first stage is in x's own bounds. */

static const double TOLERANCE = 1e-9, DEPENDENT = 1e-11, ALLOWED = 1e-6;

/* Elements of a row of unit length from the first one that is not 0 on; returns that one's number. */
static inline int row_of(const program *p, int row, double *to) {
  if (row < NV) {
    for (int k = row; k < NV; k++) to[k] = p->inverse[row][k] / p->length[row];
    return row;
  }
  int r = row - NV;
  const double *a = p->inverse[r], *b = p->inverse[r - NA];
  for (int k = r - NA; k < NV; k++) to[k] = (a[k] - b[k]) / p->length[row];
  return r - NA;
}

static inline int row_at(int active) { return active < 0 ? -active - 1 : active; }

/* Takes the row `active` of signed rows in as the last; returns 1 where it depends on the others, whose combination is in `by` then. */
static int enter(program *p, int active, double *by) {
  double row[NV], other[NV];
  int n = p->count, first = row_of(p, row_at(active), row);
  for (int i = 0; i <= n; i++) {
    int code = i < n ? p->active[i] : active, at = row_of(p, row_at(code), other), from = at > first ? at : first;
    double sum = 0;
    for (int k = from; k < NV; k++) sum += row[k] * other[k];
    p->gram[n][i] = (code < 0) == (active < 0) ? sum : -sum;
  }
  for (int i = 0; i < n; i++) {
    double sum = p->gram[n][i];
    for (int k = 0; k < i; k++) sum -= p->lower[i][k] * p->lower[n][k];
    p->lower[n][i] = sum / p->lower[i][i];
  }
  double left = p->gram[n][n];
  for (int k = 0; k < n; k++) left -= p->lower[n][k] * p->lower[n][k];
  if (n == NV || left < DEPENDENT) {
    for (int i = n - 1; i >= 0; i--) {
      by[i] = p->lower[n][i];
      for (int k = i + 1; k < n; k++) by[i] -= p->lower[k][i] * by[k];
      by[i] /= p->lower[i][i];
    }
    return 1;
  }
  p->lower[n][n] = sqrt(left);
  p->active[n] = active;
  p->multiplier[n] = 0;
  p->count++;
  return 0;
}

static void leave(program *p, int which) {
  int n = --p->count;
  for (int i = which; i < n; i++) {
    p->active[i] = p->active[i + 1];
    p->multiplier[i] = p->multiplier[i + 1];
    memcpy(p->gram[i], p->gram[i + 1], which * sizeof(double));
    for (int k = which; k <= i; k++) p->gram[i][k] = p->gram[i + 1][k + 1];
  }
  for (int i = which; i < n; i++)
    for (int j = 0; j <= i; j++) {
      double sum = p->gram[i][j];
      for (int k = 0; k < j; k++) sum -= p->lower[i][k] * p->lower[j][k];
      p->lower[i][j] = j < i ? sum / p->lower[j][j] : sqrt(most(sum, DEPENDENT));
    }
}

/* Takes a Hessian, of which the upper half is given and destroyed, and the rows that were active before. */
static void take(program *p, double H[NV][NV], int cold) {
  double largest = 0, by[NV];
  for (int i = 0; i < NV; i++) largest = most(largest, H[i][i]);
  p->status = !isfinite(largest) ? NOT_FINITE : upper(NV, H[0], NV, 1e-9 * largest) ? NOT_CONVEX : SOLVED;
  if (p->status) return;
  double (*V)[NV] = p->inverse;
  p->scale = H[0][0] * H[0][0];
  memset(V, 0, sizeof p->inverse);
  for (int i = NV - 1; i >= 0; i--) {
    double inverse = 1 / H[i][i];
    V[i][i] = H[0][0] * inverse;
    int k = i + 1;
    for (; k + 4 <= NV; k += 4) {
      double s = H[i][k] * inverse, t = H[i][k + 1] * inverse, u = H[i][k + 2] * inverse, v = H[i][k + 3] * inverse;
      for (int j = k; j < NV; j++) V[i][j] -= s * V[k][j] + t * V[k + 1][j] + u * V[k + 2][j] + v * V[k + 3][j];
    }
    for (; k < NV; k++) { double s = H[i][k] * inverse; for (int j = k; j < NV; j++) V[i][j] -= s * V[k][j]; }
  }
  for (int i = 0; i < NV; i++) {
    double own = 0, change = 0;
    for (int k = i; k < NV; k++) own += V[i][k] * V[i][k];
    p->length[i] = sqrt(own);
    if (i < NA) continue;
    for (int k = i - NA; k < NV; k++) { double d = V[i][k] - V[i - NA][k]; change += d * d; }
    p->length[NV + i] = sqrt(change);
  }
  int before = p->count, codes[NV];
  memcpy(codes, p->active, before * sizeof(int));
  p->count = 0;
  for (int i = 0; i < before && !cold; i++) enter(p, codes[i], by);
}

/* One run from the active rows at hand; low and high are those of the 2 NV rows. Returns a status; x and iterations. */
static int descend(program *p, const double *free, const double *low, const double *high, int limit, double *x, int *iterations) {
  double star[NV], by[NV], row[NV], u[NV];
  for (int i = 0; i < p->count; i++) p->multiplier[i] = 0;
  for (; *iterations < limit; ++*iterations) {
    int n = p->count, gone = -1;
    for (int i = 0; i < n; i++) { /* multipliers at which all active rows are met */
      int code = p->active[i], r = row_at(code);
      double off = r < NV ? free[r] : free[r - NV] - free[r - NV - NA];
      double sum = (code < 0 ? low[r] - off : off - high[r]) / p->length[r];
      for (int k = 0; k < i; k++) sum -= p->lower[i][k] * star[k];
      star[i] = sum / p->lower[i][i];
    }
    for (int i = n - 1; i >= 0; i--) {
      for (int k = i + 1; k < n; k++) star[i] -= p->lower[k][i] * star[k];
      star[i] /= p->lower[i][i];
    }
    double part = 1, worst = 0;
    for (int i = 0; i < n; i++) {
      if (star[i] >= 0) continue;
      double way = p->multiplier[i] / (p->multiplier[i] - star[i]);
      if (way < part || (way == part && star[i] < worst)) { part = way; gone = i; worst = star[i]; }
    }
    if (gone >= 0) {
      for (int i = 0; i < n; i++) p->multiplier[i] += part * (star[i] - p->multiplier[i]);
      leave(p, gone);
      continue;
    }
    memset(u, 0, sizeof u);
    for (int i = 0; i < n; i++) {
      int code = p->active[i], from = row_of(p, row_at(code), row);
      double s = code < 0 ? star[i] : -star[i];
      p->multiplier[i] = star[i];
      for (int k = from; k < NV; k++) u[k] += s * row[k];
    }
    int enters = 0, found = 0;
    double beyond = TOLERANCE;
    for (int i = 0; i < NV; i++) {
      double sum = free[i];
      for (int k = i; k < NV; k++) sum += p->inverse[i][k] * u[k];
      x[i] = sum;
    }
    for (int r = 0; r < 2 * NV; r++) {
      if (r >= NV && r < NV + NA) continue;
      double at = r < NV ? x[r] : x[r - NV] - x[r - NV - NA], under = (low[r] - at) / p->length[r], over = (at - high[r]) / p->length[r];
      if (most(under, over) <= beyond) continue;
      int active = 0;
      for (int i = 0; i < n && !active; i++) active = row_at(p->active[i]) == r;
      if (active) continue;
      found = 1;
      beyond = most(under, over);
      enters = under > over ? -r - 1 : r;
    }
    if (!found) return SOLVED;
    double whole = 0;
    while (enter(p, enters, by)) { /* it depends on active rows: one of them goes */
      double step = INFINITY;
      int out = -1;
      for (int i = 0; i < p->count; i++) if (by[i] > 0 && p->multiplier[i] / by[i] < step) { step = p->multiplier[i] / by[i]; out = i; }
      if (out < 0) return INFEASIBLE;
      for (int i = 0; i < p->count; i++) p->multiplier[i] -= step * by[i];
      leave(p, out);
      whole += step;
    }
    p->multiplier[p->count - 1] = whole;
  }
  return ITERATIONS;
}

/* Minimiser of ½ xᵀ H x + fᵀ x within bounds, H as taken. Returns a status. */
static int minimise(program *p, const double *f, const double *low, const double *high, int limit, double *x, int *iterations) {
  double free[NV], half[NV] = {0};
  *iterations = 0;
  if (p->status) return p->status;
  for (int i = 0; i < NV; i++) for (int k = i; k < NV; k++) half[k] += p->inverse[i][k] * f[i];
  for (int i = 0; i < NV; i++) {
    free[i] = 0;
    for (int k = i; k < NV; k++) free[i] -= p->inverse[i][k] * half[k];
    free[i] /= p->scale;
    if (!isfinite(free[i])) return NOT_FINITE;
    if (!(low[i] <= high[i] && (i < NA || low[NV + i] <= high[NV + i]))) return INFEASIBLE;
  }
  int status = INEXACT;
  for (int cold = 0; cold < 2; cold++) {
    if (cold) p->count = 0;
    status = descend(p, free, low, high, limit, x, iterations);
    if (status) continue;
    double size = 1, beyond = 0;
    for (int i = 0; i < NV; i++) {
      beyond = most(beyond, most(low[i] - x[i], x[i] - high[i]));
      if (i >= NA) { double d = x[i] - x[i - NA]; beyond = most(beyond, most(low[NV + i] - d, d - high[NV + i])); }
      size = most(size, fabs(x[i]));
    }
    for (int i = 0; i < NV; i++) x[i] = within(x[i], low[i], high[i]);
    if (beyond <= ALLOWED * size) return SOLVED;
    status = INEXACT;
  }
  p->count = 0;
  return status;
}
