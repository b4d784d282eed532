/* The quadratic program in the tensions: bounds of each and of its change from stage to stage.

   With x = V u + free, V = scale (upper factor of H)^-1, it is the least |u|² within rows of length 1. A dual active-set method goes from
   the rows that were active before (Goldfarb, Idnani, Mathematical Programming 27, 1983; Arnström, Bemporad, Axehill, IEEE TAC 67(8),
   2022), with a Cholesky factor of the active rows' products, ready before the sample. Row k < NV is x's, row NV + k that of its change
   from the stage before, which for the first stage is in x's own bounds. */

static const double TOLERANCE = 1e-9, DEPENDENT = 1e-11, ALLOWED = 1e-6, SINGULAR = 1e-9, MOST_MORE = 1e-4; /* as qp.py has them */

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
  double row[NV], other[NV], *to = p->lower[p->count], left = 0;
  int n = p->count, first = row_of(p, row_at(active), row);
  for (int k = first; k < NV; k++) left += row[k] * row[k];
  for (int i = 0; i < n; i++) {
    int from = row_of(p, row_at(p->active[i]), other);
    double sum = 0;
    for (int k = from > first ? from : first; k < NV; k++) sum += row[k] * other[k];
    if ((p->active[i] < 0) != (active < 0)) sum = -sum;
    for (int k = 0; k < i; k++) sum -= p->lower[i][k] * to[k];
    to[i] = sum / p->lower[i][i];
    left -= to[i] * to[i];
  }
  if (n == NV || left < DEPENDENT) {
    for (int i = n - 1; i >= 0; i--) {
      by[i] = to[i];
      for (int k = i + 1; k < n; k++) by[i] -= p->lower[k][i] * by[k];
      by[i] /= p->lower[i][i];
    }
    return 1;
  }
  to[n] = sqrt(left);
  p->active[n] = active;
  p->multiplier[n] = 0;
  p->count++;
  return 0;
}

/* Takes an active row out; rotations of two columns at a time make the factor triangular again. */
static void leave(program *p, int which) {
  int n = --p->count;
  for (int i = which; i < n; i++) {
    p->active[i] = p->active[i + 1];
    p->multiplier[i] = p->multiplier[i + 1];
    memcpy(p->lower[i], p->lower[i + 1], (i + 2) * sizeof(double));
  }
  for (int j = which; j < n; j++) {
    double a = p->lower[j][j], b = p->lower[j][j + 1], length = sqrt(a * a + b * b), c = a / length, s = b / length;
    for (int i = j; i < n; i++) {
      double x = p->lower[i][j], y = p->lower[i][j + 1];
      p->lower[i][j] = c * x + s * y;
      p->lower[i][j + 1] = c * y - s * x;
    }
  }
}

/* Takes a Hessian, scale[i] scale[j] hessian[i][j], of which the upper half is given, with as little more on its diagonal as makes it
   definite, and the rows that were active before. */
static void take(program *p, double hessian[NV][NV], const double *scale) {
  double largest = 0, more = 0, by[NV], H[NV][NV], (*V)[NV] = p->inverse;
  for (int i = 0; i < NV; i++) largest = most(largest, hessian[i][i] * scale[i] * scale[i]);
  for (p->status = NOT_CONVEX; p->status && more <= MOST_MORE && largest > 0 && largest < INFINITY; more = most(SINGULAR, 100 * more)) {
    for (int i = 0; i < NV; i++) {
      for (int j = 0; j < NV; j++) H[i][j] = j < i ? 0 : hessian[i][j] * (scale[i] * scale[j]); /* from 0: GCC 12 misaligns from i */
      H[i][i] += more * largest;
    }
    if (!upper(NV, H[0], NV, SINGULAR * largest)) p->status = SOLVED;
  }
  if (!isfinite(largest)) p->status = NOT_FINITE;
  if (p->status) return;
  p->scale = H[0][0] * H[0][0];
  for (int i = NV - 1; i >= 0; i -= 2) { /* two rows at once, of which the upper one needs the lower one, too (a last one is alone); 0 below
                                            the diagonal */
    int top = i > 0 ? i - 1 : i;
    double *restrict low = V[i], *restrict high = i > 0 ? V[top] : by, inverse = 1 / H[i][i], above = 1 / H[top][top];
    memset(low + i, 0, (NV - i) * sizeof(double));
    memset(high + top, 0, (NV - top) * sizeof(double));
    int k = i + 1;
    for (; k + 4 <= NV; k += 4) {
      double s = H[i][k], t = H[i][k + 1], u = H[i][k + 2], v = H[i][k + 3];
      double w = H[top][k], x = H[top][k + 1], y = H[top][k + 2], z = H[top][k + 3];
      for (int j = k; j < NV; j++) {
        low[j] -= s * V[k][j] + t * V[k + 1][j] + u * V[k + 2][j] + v * V[k + 3][j];
        high[j] -= w * V[k][j] + x * V[k + 1][j] + y * V[k + 2][j] + z * V[k + 3][j];
      }
    }
    for (; k < NV; k++) {
      double s = H[i][k], w = H[top][k];
      for (int j = k; j < NV; j++) { low[j] -= s * V[k][j]; high[j] -= w * V[k][j]; }
    }
    low[i] = H[0][0];
    for (int j = i; j < NV; j++) low[j] *= inverse;
    if (top == i) break;
    high[top] = H[0][0];
    for (int j = i; j < NV; j++) high[j] -= H[top][i] * low[j];
    for (int j = top; j < NV; j++) high[j] *= above;
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
  for (int i = 0; i < before; i++) enter(p, codes[i], by);
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
