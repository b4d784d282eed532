/* Parts of a direction that enter a segment: levels, velocities, edge states, properties, parameters. */
enum { AT_V = 2 * NB, AT_Y = 4 * NB, AT_P = AT_Y + NEDGE, AT_THETA = AT_P + NPROP, SEGMENT = AT_THETA + NTHETA };

static void properties_along(stepper *m, work *w, double t, const vector *a, int group, vector *P_level_0) {
  vector in[NU + NEXT + NTHETA];
  memcpy(in, a, NU * sizeof(vector));
  look_along(m->inputs, t, 0, NU, NEXT, 0, group, in + NU);
  memcpy(in + NU + NEXT, m->inputs->d_theta + group * NTHETA, NTHETA * sizeof(vector));
  memset(P_level_0, 0, (NLEV * NPROP + NB) * sizeof(vector));
  for (int k = 0; k < properties_by_nnz; k++) P_level_0[properties_by_row[k]] += w->by_properties[k] * in[properties_by_col[k]];
}

/* Columns of parameters that no direction changes are left out. */
static void choose(work *w, int groups, const vector *d_theta) {
  char changes[NTHETA] = {0};
  for (int k = 0; k < groups * NTHETA; k++) for (int lane = 0; lane < LANES; lane++) changes[k % NTHETA] |= d_theta[k][lane] != 0;
  selection *c = &w->chosen;
  int count = 0;
  for (int row = 0; row < BY_ROWS; row++) {
    c->start[row] = count;
    for (int of_velocities = 0; of_velocities < 2; of_velocities++) {
      if (of_velocities) c->moving[row] = count;
      for (int k = 0; k < segment_by_nnz; k++) {
        int column = segment_by_col[k];
        if (segment_by_row[k] != row || (column >= AT_V && column < AT_Y) != of_velocities) continue;
        if (column >= AT_THETA && !changes[column - AT_THETA]) continue;
        c->entry[count] = k;
        c->column[count++] = column;
      }
    }
  }
  c->start[BY_ROWS] = count;
}

/* Some of the chosen entries of a segment times a direction; sums of their own that do not wait for each other. */
static inline vector product(const work *w, int s, int from, int until, const vector *in) {
  const double *by = w->by[s];
  const int *column = w->chosen.column;
  vector sum[4] = {{0}};
  int k = from;
  for (; k + 4 <= until; k += 4) for (int i = 0; i < 4; i++) sum[i] += by[k + i] * in[column[k + i]];
  for (; k < until; k++) sum[0] += by[k] * in[column[k]];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Jacobians of a stage: segments (and, if `resting`, the factored stiffness of the network at rest), properties. */
static int linearise(work *w, double step, const double *a, int resting) {
  const double *arg_P[] = {a, w->external, w->theta};
  double *res_P[] = {w->by_properties};
  run(properties_by, w, arg_P, res_P);
  vector time = (vector){0} + step, by[segment_by_nnz];
  for (int first = 0; first < NLEV; first += LANES) {
    batch b;
    int count = gather(w, first, &b);
    const vector *arg[] = {b.x[0], b.x[1], b.v[0], b.v[1], b.y, &time, w->packed_P[first / LANES], w->packed_theta};
    vector *res[] = {by};
    segment_by_lanes(arg, res);
    for (int k = 0; k < w->chosen.start[BY_ROWS]; k++)
      for (int lane = 0; lane < count; lane++) w->by[first + lane][k] = by[w->chosen.entry[k]][lane];
    if (!resting) continue;
    vector matrix[4 * NB * NB] = {{0}};
    for (int k = 0; k < segment_by_nnz; k++)
      if (segment_by_row[k] < 2 * NB && segment_by_col[k] < 2 * NB) matrix[segment_by_col[k] * 2 * NB + segment_by_row[k]] = by[k];
    scatter(w, first, count, matrix);
  }
  return resting ? factor(w) : 0;
}

/* One group of directions through a stage: from *d at its start (x_0, v_0, y_0) to the rates at its end, with the matrix at hand.
   Without `step` the network rests and d->x becomes how its equilibrium moves. */
static void differentiate(stepper *m, work *w, int group, double t, double step, const vector *a, lane_rates *d, levels v_0) {
  vector P[NLEV * NPROP + NB], rhs[NLEV + 2][NB] = {{{0}}}, in[SEGMENT];
  const selection *c = &w->chosen;
  properties_along(m, w, t, a, group, P);
  memcpy(d->x[0], P + NLEV * NPROP, sizeof d->x[0]);
  memset(d->v[0], 0, sizeof d->v[0]);
  memcpy(in + AT_THETA, m->inputs->d_theta + group * NTHETA, NTHETA * sizeof(vector));
  for (int s = 0; s < NLEV; s++) {
    memcpy(in, d->x[s], 2 * NB * sizeof(vector));
    memcpy(in + AT_Y, d->y[s], NEDGE * sizeof(vector));
    memcpy(in + AT_P, P + s * NPROP, NPROP * sizeof(vector));
    for (int i = 0; i < 2 * NB; i++) rhs[s + i / NB][i % NB] -= product(w, s, c->start[i], c->moving[i], in);
    if (step > 0)
      for (int i = 0; i < NB; i++)
        rhs[s + 1][i] += (w->P[s][MASS] * d->v[s + 1][i] - P[s * NPROP + MASS] * (w->v[s + 1][i] - v_0[s + 1][i])) / step;
  }
  solve_lanes(w, rhs);
  memset(rhs[0], 0, sizeof rhs[0]);
  for (int l = 1; l <= NLEV; l++)
    for (int i = 0; i < NB; i++) {
      d->x[l][i] += rhs[l][i];
      if (step > 0) { vector v = rhs[l][i] / step; d->v[l][i] = (v - d->v[l][i]) / step; rhs[l][i] = v; }
    }
  if (!(step > 0)) return;
  for (int s = 0; s < NLEV && NEDGE; s++) {
    memcpy(in, d->x[s], 2 * NB * sizeof(vector));
    memcpy(in + AT_V, rhs[s], 2 * NB * sizeof(vector));
    memcpy(in + AT_Y, d->y[s], NEDGE * sizeof(vector));
    memcpy(in + AT_P, P + s * NPROP, NPROP * sizeof(vector));
    for (int i = 0; i < NEDGE; i++) d->y[s][i] = product(w, s, c->start[2 * NB + i], c->start[2 * NB + i + 1], in);
  }
  memcpy(d->x[1], rhs[1], NLEV * sizeof rhs[0]); /* rates: velocity, acceleration, dy/dt */
}

