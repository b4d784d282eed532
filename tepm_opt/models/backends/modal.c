/* The network's slow motion about an equilibrium: its first modes from those of a neighbour, by subspace iteration on the factor of the
   stiffness. solvers/linear/modal_model.py is the twin. NMODE modes and a few shapes more, NSHAPE in all, are carried along. */

#define NCO (NLEV * NB)
#define NACT (NU / 2)
#define NSV ((NSHAPE + LANES - 1) / LANES)  /* vectors of a coordinate's row */
#define NMV ((NMODE + LANES - 1) / LANES)
#define NAV ((NACT + LANES - 1) / LANES)
#define NWIDE (NSV * LANES)

typedef vector shapes[NLEV + 2][NB];        /* LANES of them; levels 1 … NLEV count */
typedef struct {
  work w;
  shapes loads[NSV], moved[NSV], axial[NAV];
  double small[2][NWIDE][NWIDE], turn[NWIDE][NWIDE];
} modal_work;

/* Symmetric products of the shapes a and b, weighted by masses unless null, (NSHAPE, NSHAPE). */
static void gram(shapes *a, shapes *b, const double *masses, double out[NWIDE][NWIDE]) {
  for (int i = 0; i < NSHAPE; i++) {
    vector sum[NSV] = {{0}};
    const double *left = (const double *)a[i / LANES][1] + i % LANES;
    for (int c = 0; c < NCO; c++) {
      double scale = left[c * LANES] * (masses ? masses[c] : 1);
      for (int g = 0; g < NSV; g++) sum[g] += scale * (&b[g][1][0])[c];
    }
    memcpy(out[i], sum, sizeof sum);
  }
}

/* Eigenvalues (ascending) and vectors (columns of y, normalised by m) of k y = value m y, by Cholesky's factor of m and Jacobi's
   rotations; k and m are destroyed. Returns 1 where m is not positive definite. */
static int reduced(double k[NWIDE][NWIDE], double m[NWIDE][NWIDE], double y[NWIDE][NWIDE], double *values) {
  for (int j = 0; j < NSHAPE; j++) {
    for (int i = 0; i < j; i++) for (int l = j; l < NSHAPE; l++) m[j][l] -= m[i][j] * m[i][l]; /* rows of the upper factor */
    if (!(m[j][j] > 0)) return 1;
    double inverse = 1 / sqrt(m[j][j]);
    for (int l = j; l < NSHAPE; l++) m[j][l] *= inverse;
  }
  for (int i = 0; i < NSHAPE; i++) { /* twice: k = (upper)^-T k, transposed */
    for (int j = 0; j < i; j++) for (int l = 0; l < NSHAPE; l++) k[i][l] -= m[j][i] * k[j][l];
    for (int l = 0; l < NSHAPE; l++) k[i][l] /= m[i][i];
  }
  for (int l = 0; l < NSHAPE; l++)
    for (int i = 0; i < NSHAPE; i++) {
      double sum = k[l][i];
      for (int j = 0; j < i; j++) sum -= m[j][i] * k[l][j];
      k[l][i] = sum / m[i][i];
    }
  memset(y, 0, sizeof(double) * NWIDE * NWIDE); /* rows are vectors */
  for (int i = 0; i < NSHAPE; i++) y[i][i] = 1;
  for (int sweep = 0; sweep < 30; sweep++) {
    double off = 0, on = 0;
    for (int i = 0; i < NSHAPE; i++) { on += k[i][i] * k[i][i]; for (int j = 0; j < i; j++) off += k[i][j] * k[i][j]; }
    if (off <= 1e-32 * on) break;
    for (int p = 0; p < NSHAPE; p++)
      for (int q = p + 1; q < NSHAPE; q++) {
        if (k[p][q] * k[p][q] <= 1e-36 * k[p][p] * k[q][q]) continue;
        double at = (k[q][q] - k[p][p]) / (2 * k[p][q]), t = (at < 0 ? -1 : 1) / (fabs(at) + sqrt(1 + at * at));
        double c = 1 / sqrt(1 + t * t), s = t * c, pp = k[p][p] - t * k[p][q], qq = k[q][q] + t * k[p][q];
        for (int l = 0; l < NWIDE; l++) {
          double a = k[p][l], b = k[q][l], d = y[p][l], e = y[q][l];
          k[p][l] = c * a - s * b;
          k[q][l] = s * a + c * b;
          y[p][l] = c * d - s * e;
          y[q][l] = s * d + c * e;
        }
        for (int l = 0; l < NSHAPE; l++) { k[l][p] = k[p][l]; k[l][q] = k[q][l]; }
        k[p][p] = pp; k[q][q] = qq; k[p][q] = k[q][p] = 0;
      }
  }
  int order[NSHAPE];
  double sorted[NSHAPE][NSHAPE];
  for (int i = 0; i < NSHAPE; i++) {
    int j = i;
    for (; j && k[order[j - 1]][order[j - 1]] > k[i][i]; j--) order[j] = order[j - 1];
    order[j] = i;
  }
  for (int i = 0; i < NSHAPE; i++) { /* (upper)^-1 of each vector */
    double *v = sorted[i];
    memcpy(v, y[order[i]], sizeof sorted[i]);
    values[i] = k[order[i]][order[i]];
    for (int r = NSHAPE - 1; r >= 0; r--) {
      for (int l = r + 1; l < NSHAPE; l++) v[r] -= m[r][l] * v[l];
      v[r] /= m[r][r];
    }
  }
  for (int i = 0; i < NSHAPE; i++) for (int r = 0; r < NSHAPE; r++) y[r][i] = sorted[i][r];
  return 0;
}

/* One way from the basis to a better one: loads, solutions, the reduced problem. Returns whether the modes have
   converged, -1 if it fails. */
static int sweep_shapes(modal_work *o, const double *masses, double near, double *basis, double *values) {
  for (int g = 0; g < NSV; g++) {
    for (int c = 0; c < NCO; c++)
      for (int lane = 0; lane < LANES; lane++) {
        int i = g * LANES + lane;
        (&o->loads[g][1][0])[c][lane] = i < NSHAPE ? masses[c] * basis[c * NSHAPE + i] : 0;
      }
    memcpy(o->moved[g], o->loads[g], sizeof(shapes));
    solve(&o->w, o->moved[g]);
  }
  gram(o->loads, o->moved, 0, o->small[0]);
  gram(o->moved, o->moved, masses, o->small[1]);
  if (reduced(o->small[0], o->small[1], o->turn, values)) return -1;
  for (int c = 0; c < NCO; c++) {
    vector sum[NSV] = {{0}};
    for (int i = 0; i < NSHAPE; i++) {
      double scale = (&o->moved[i / LANES][1][0])[c][i % LANES];
      for (int g = 0; g < NSV; g++) sum[g] += scale * *(vector *)(o->turn[i] + g * LANES);
    }
    memcpy(basis + c * NSHAPE, sum, NSHAPE * sizeof(double));
  }
  for (int i = 0; i < NMODE; i++) {
    double length = 0;
    for (int r = 0; r < NSHAPE; r++) length += o->turn[r][i] * o->turn[r][i];
    if (!(length < (1 + near * near) * values[i] * values[i])) return 0;
  }
  return 1;
}

/* Damping in the modes, (NMODE, NMODE), segment by segment. */
static void damp(work *w, const double *basis, double *damping) {
  vector sum[NMODE][NMV], z[2 * NB][NMV], y;
  memset(sum, 0, sizeof sum);
  memset(z, 0, sizeof z);
  for (int s = 0; s < NLEV; s++) {
    const double *arg[] = {w->x[s], w->x[s + 1], w->P[s], w->theta}, *d = w->first;
    double *res[] = {w->first, w->second};
    segment_damping(arg, res);
    memcpy(z, z + NB, NB * sizeof *z);
    for (int k = 0; k < NB; k++) memcpy(z[NB + k], basis + (s * NB + k) * NSHAPE, NMODE * sizeof(double));
    for (int r = 0; r < 2 * NB; r++)
      for (int g = 0; g < NMV; g++) {
        y = (vector){0};
        for (int c = 0; c < NB; c++) y += d[2 * NB * c + r] * z[c][g];
        if (r < NB) for (int c = 0; c < NB; c++) y += d[2 * NB * r + NB + c] * z[NB + c][g];
        else for (int c = 0; c < NB; c++) y += w->second[NB * c + r - NB] * z[NB + c][g];
        for (int i = 0; i < NMODE; i++) sum[i][g] += z[r][i / LANES][i % LANES] * y;
      }
  }
  for (int i = 0; i < NMODE; i++) memcpy(damping + i * NMODE, sum[i], NMODE * sizeof(double));
}

/* Slow motion about an equilibrium x under u (`mapped`: the effective actuation) and external forces: values of the shapes (squares of
   angular frequencies), damping (NMODE, NMODE), drive by axial forces (NMODE, NACT), points by modes (NEXT, NMODE) and, at rest, by axial
   forces (NEXT, NACT). `basis`, (NCO, NSHAPE), is that of a neighbour and becomes this one's in at most `sweeps`; without any, basis and
   values are this one's already. `by`: points by free coordinates, (NEXT, NCO). Returns a status. */
int modal(const double *x, const double *u, int mapped, const double *external, const double *theta, const double *masses,
          const double *by, int sweeps, double near, double *basis, double *values, double *damping, double *drive, double *observed,
          double *gain) {
  modal_work *o = aligned_alloc(64, (sizeof(modal_work) + 63) / 64 * 64);
  if (!o) return STALLED;
  work *w = &o->w;
  w->theta = theta;
  if (mapped) memcpy(w->a, u, sizeof w->a);
  else map_inputs(w, u, w->a);
  set_properties(w, external);
  memcpy(w->x, x, sizeof w->x);
  memcpy(w->x[0], w->level_0, sizeof w->level_0);
  assemble(w, 0);
  int status = factor(w) ? INDEFINITE : SOLVED, done = !sweeps;
  for (; status == SOLVED && !done; sweeps--) {
    if (!sweeps) { status = EXHAUSTED; break; }
    done = sweep_shapes(o, masses, near, basis, values);
    if (done < 0) status = STALLED;
  }
  if (status == SOLVED) {
    memset(o->axial, 0, sizeof o->axial);
    memset(drive, 0, NMODE * NACT * sizeof(double));
    for (int s = 0; s < NLEV; s++)
      for (int j = 0; j < NB / 3; j++) {
        int which = s / (NLEV / (NACT / (NB / 3))) * (NB / 3) + j;
        double span[3], length = 0;
        for (int k = 0; k < 3; k++) { span[k] = w->x[s + 1][3 * j + k] - w->x[s][3 * j + k]; length += span[k] * span[k]; }
        for (int k = 0; k < 3; k++) {
          const double *at = basis + (s * NB + 3 * j + k) * NSHAPE;
          double along = span[k] / sqrt(length), *upper = (double *)&o->axial[which / LANES][s + 1][3 * j + k];
          upper[which % LANES] += along;
          if (s) ((double *)&o->axial[which / LANES][s][3 * j + k])[which % LANES] -= along;
          for (int i = 0; i < NMODE; i++)
            drive[i * NACT + which] += along * (at[i] - (s ? at[i - NB * NSHAPE] : 0));
        }
      }
    for (int g = 0; g < NAV; g++) solve(w, o->axial[g]);
    memset(observed, 0, NEXT * NMODE * sizeof(double));
    memset(gain, 0, NEXT * NACT * sizeof(double));
    for (int p = 0; p < NEXT; p++)
      for (int c = 0; c < NCO; c++) {
        double weight = by[p * NCO + c];
        if (weight == 0) continue;
        for (int i = 0; i < NMODE; i++) observed[p * NMODE + i] += weight * basis[c * NSHAPE + i];
        for (int j = 0; j < NACT; j++) gain[p * NACT + j] += weight * (&o->axial[j / LANES][1][0])[c][j % LANES];
      }
    damp(w, basis, damping);
  }
  free(o);
  return status;
}
