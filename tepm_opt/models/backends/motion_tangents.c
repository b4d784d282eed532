/* How the inputs at that time change in the directions of a group; `what` are those whose delay moves the time. */
static void look_along(history *h, double t, int left, int from, int count, int what, int group, vector *values) {
  double part = place(h, t, left), slope = part > 0 && part < 1 ? 1 / (h->time[h->at + 1] - h->time[h->at]) : 0;
  const double *row = h->rows + h->at * NINPUT + from;
  const vector *d = h->d_rows ? h->d_rows + (h->at * h->groups + group) * NINPUT + from : 0;
  vector sooner = {0};
  for (int k = 0; k < delay_by_nnz; k++)
    if (delay_by_row[k] == what) sooner -= h->by_delay[k] * h->d_theta[group * NTHETA + delay_by_col[k]];
  for (int k = 0; k < count; k++) {
    values[k] = sooner * slope * (row[NINPUT + k] - row[k]);
    if (d) values[k] += d[k] + part * (d[h->groups * NINPUT + k] - d[k]);
  }
}

/* How the delay changes with the parameters at the time that kernels know. */
static void delay_along(stepper *m, work *w) {
#if TIMED
  const double *arg[] = {w->theta};
  double *res[] = {m->motion.inputs.by_delay};
  run(delay_by, arg, res);
#endif
}

/* out += the entries of a Jacobian times what changes, a term after the other. */
static inline void add_terms(const term *terms, int count, const double *by, const vector *in, vector *out) {
  for (const term *t = terms; t < terms + count; t++) out[t->row] += by[t->at] * in[t->column];
}

/* Move the inputs along the directions with those of the motion itself; they do not move where nothing changes them. */
static void move_inputs_along(stepper *m, work *w, const double **arg, double at, double duration, int left) {
  if (!m->groups || !m->inputs_change) return;
  history *h = &m->motion.inputs;
  double *by[] = {w->by_inputs};
  delay_along(m, w);
  run(input_motion_by, arg, by);
  for (int g = 0; g < m->groups; g++) {
    tangent *d = m->d + g;
    vector *in = w->in_directions.in, *out = w->in_directions.out;
    look_along(h, at, left, 0, NU, COMMANDS, g, in);
    for (int k = 0; k < NU; k++) { in[NU + k] = (in[k] - d->u[k]) / duration; d->u[k] = in[k]; }
    memcpy(in + 2 * NU, d->y_inputs, NIN * sizeof(vector));
    memcpy(in + 2 * NU + NIN, h->d_theta + g * NTHETA, NTHETA * sizeof(vector));
    memset(out, 0, sizeof w->in_directions.out);
    add_terms(m->changes[g].by_inputs, m->changes[g].inputs, w->by_inputs, in, out);
    memcpy(d->a, out, sizeof d->a);
    memcpy(d->y_inputs, out + NU, NIN * sizeof(vector));
  }
}

/* Parts of a direction that enter a segment: levels, velocities, edge states, properties, parameters. */
enum { AT_V = 2 * NB, AT_Y = 4 * NB, AT_P = AT_Y + NEDGE, AT_THETA = AT_P + NPROP };

static void properties_along(stepper *m, work *w, double t, const vector *a, int group, vector *P_level_0) {
  vector *in = w->in_directions.in;
  memcpy(in, a, NU * sizeof(vector));
  look_along(&m->motion.inputs, t - m->motion.inputs.delay[FORCES], 0, NU, NEXT, FORCES, group, in + NU);
  memcpy(in + NU + NEXT, m->motion.inputs.d_theta + group * NTHETA, NTHETA * sizeof(vector));
  memset(P_level_0, 0, (NLEV * NPROP + NB) * sizeof(vector));
  add_terms(m->changes[group].by_properties, m->changes[group].properties, w->by_properties, in, P_level_0);
}

/* The entries of a Jacobian whose columns before `own` all count, if `others` do, and from there on those of parameters that change. */
static int choose_terms(term *terms, int count, const int *row, const int *column, int own, int others, const char *changes) {
  int chosen = 0;
  for (int k = 0; k < count; k++)
    if (column[k] < own ? others : changes[column[k] - own]) terms[chosen++] = (term){row[k], k, column[k]};
  return chosen;
}

/* Which entries of the Jacobians count: all by what moves; of those by parameters, and by properties, what a group's directions change. */
static void choose(stepper *m, work *w) {
  const history *h = &m->motion.inputs;
  selection *c = &w->chosen;
  char of_theta[NTHETA_ROOM], of_segment[NPROP + NTHETA_ROOM];
  int count = 0, kept_at[segment_by_nnz_ROOM];
  for (int row = 0; row < BY_ROWS; row++) {
    c->start[row] = count;
    for (int of_velocities = 0; of_velocities < 2; of_velocities++) {
      if (of_velocities) c->moving[row] = count;
      for (int k = 0; k < segment_by_nnz; k++) {
        int column = segment_by_col[k];
        if (segment_by_row[k] != row || column >= AT_P || (column >= AT_V && column < AT_Y) != of_velocities) continue;
        c->entry[count] = k;
        c->column[count++] = column;
      }
    }
  }
  c->start[BY_ROWS] = c->count = count;
  memset(kept_at, 0, sizeof kept_at); /* 0 where not yet: others come first */
  m->inputs_change = h->d_rows != 0;
  for (int g = 0; g < m->groups; g++) {
    changes *to = m->changes + g;
    memset(of_theta, 0, sizeof of_theta);
    for (int k = 0; k < NTHETA; k++) for (int lane = 0; lane < LANES; lane++) of_theta[k] |= h->d_theta[g * NTHETA + k][lane] != 0;
    int late = 0;
    for (int k = 0; k < delay_by_nnz; k++) late |= of_theta[delay_by_col[k]];
    int on_inputs = choose_terms(to->by_inputs, input_motion_by_nnz, input_motion_by_row, input_motion_by_col, 2 * NU + NIN, 0, of_theta);
    int driven = h->d_rows || late || on_inputs;
    m->inputs_change |= driven;
    to->inputs = choose_terms(to->by_inputs, input_motion_by_nnz, input_motion_by_row, input_motion_by_col, 2 * NU + NIN, driven, of_theta);
    to->properties = choose_terms(to->by_properties, properties_by_nnz, properties_by_row, properties_by_col, NU + NEXT, driven, of_theta);
    to->observed = choose_terms(to->by_observed, observe_by_nnz, observe_by_row, observe_by_col, (NLEV + 1) * NB, 1, of_theta);
    memset(of_segment, 0, NPROP);
    memcpy(of_segment + NPROP, of_theta, NTHETA);
    for (int k = 0; k < to->properties; k++)
      if (to->by_properties[k].row < NLEV * NPROP) of_segment[to->by_properties[k].row % NPROP] = 1;
    int chosen = choose_terms(to->by_segment, segment_by_nnz, segment_by_row, segment_by_col, AT_P, 0, of_segment);
    to->forces = 0;
    for (int k = 0; k < chosen; k++) {
      term entry = to->by_segment[k];
      if (!kept_at[entry.at]) { c->entry[c->count] = entry.at; kept_at[entry.at] = c->count++; }
      entry.at = kept_at[entry.at];
      to->by_segment[k] = to->by_segment[to->forces];
      if (entry.row < 2 * NB) to->by_segment[to->forces++] = entry;
      else to->by_segment[k] = entry;
    }
    to->edges = chosen - to->forces;
  }
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
static int linearise(stepper *m, work *w, double step, const double *a, int resting) {
  delay_along(m, w);
  const double *arg_P[] = {a, w->external, w->theta};
  double *res_P[] = {w->by_properties};
  run(properties_by, arg_P, res_P);
  vector time = (vector){0} + step, *by = w->in_directions.by, *matrix = w->in_forces.matrix;
  batch *b = &w->in_forces.b;
  for (int first = 0; first < NLEV; first += LANES) {
    int count = gather(w, first, b);
    const vector *arg[] = {b->x[0], b->x[1], b->v[0], b->v[1], b->y, &time, w->packed_P[first / LANES], w->packed_theta};
    vector *res[] = {by};
    segment_by_lanes(arg, res);
    for (int k = 0; k < w->chosen.count; k++)
      for (int lane = 0; lane < count; lane++) w->by[first + lane][k] = by[w->chosen.entry[k]][lane];
    if (!resting) continue;
    memset(matrix, 0, sizeof w->in_forces.matrix);
    for (int k = 0; k < segment_by_nnz; k++)
      if (segment_by_row[k] < 2 * NB && segment_by_col[k] < 2 * NB) matrix[segment_by_col[k] * 2 * NB + segment_by_row[k]] = by[k];
    scatter(w, first, count, matrix);
  }
  for (int l = 1; l <= NLEV && resting; l++)
    for (int i = 0; i < NB; i++) if (w->matrix.diagonal[l][i][i] == 0) w->matrix.diagonal[l][i][i] = STAYS;
  return resting ? factor(w) : 0;
}

/* One group of directions through a stage: from *d at its start (x_0, v_0, y_0) to the rates at its end, with the matrix at hand.
   Without `step` the network rests and d->x becomes how its equilibrium moves. */
static void differentiate(stepper *m, work *w, int group, double t, double step, const vector *a, lane_rates *d, levels v_0) {
  vector *P = w->in_directions.P, (*rhs)[NB] = w->in_directions.rhs, *in = w->in_directions.in;
  memset(rhs, 0, sizeof w->in_directions.rhs);
  const selection *c = &w->chosen;
  const changes *changed = m->changes + group;
  const term *of_edges = changed->by_segment + changed->forces;
  properties_along(m, w, t, a, group, P);
  memcpy(d->x[0], P + NLEV * NPROP, sizeof d->x[0]);
  memset(d->v[0], 0, sizeof d->v[0]);
  memcpy(in + AT_THETA, m->motion.inputs.d_theta + group * NTHETA, NTHETA * sizeof(vector));
  for (int s = 0; s < NLEV; s++) {
    memcpy(in, d->x[s], 2 * NB * sizeof(vector));
    memcpy(in + AT_Y, d->y[s], NEDGE * sizeof(vector));
    memcpy(in + AT_P, P + s * NPROP, NPROP * sizeof(vector));
    for (int i = 0; i < 2 * NB; i++) rhs[s + i / NB][i % NB] -= product(w, s, c->start[i], c->moving[i], in);
    for (const term *o = changed->by_segment; o < of_edges; o++) rhs[s + o->row / NB][o->row % NB] -= w->by[s][o->at] * in[o->column];
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
    for (const term *o = of_edges; o < of_edges + changed->edges; o++) d->y[s][o->row - 2 * NB] += w->by[s][o->at] * in[o->column];
  }
  memcpy(d->x[1], rhs[1], NLEV * sizeof rhs[0]); /* rates: velocity, acceleration, dy/dt */
}

static void copy(stepper *m, tangent *to, const tangent *from) { if (m->groups) memcpy(to, from, m->groups * sizeof *to); }

/* The actuation at a stage of the step begun. */
static void keep_actuation_along(stepper *m, int i) { for (int g = 0; g < m->groups; g++) memcpy(m->d_a[g][i], m->d[g].a, sizeof m->d[g].a); }

/* Directions through stage i at time t, of length `step`, that starts `before` s after the first; returns whether that failed. */
static int stage_along(stepper *m, work *w, int i, double t, double step, double before, const double *a, levels v_0) {
  if (!m->groups) return 0;
  forces(w, step, 0); /* the pulls at the solution, for the exact matrix */
  trust(w);
  if (assemble(m, w, step) || linearise(m, w, step, a, 0)) return 1;
  for (int g = 0; g < m->groups; g++) {
    lane_rates *d = m->stage[i] + g;
    tangent *d_s = m->d + g;
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) {
        d->x[l][k] = d_s->x[l][k] + (i ? before * m->stage[0][g].x[l][k] : (vector){0});
        d->v[l][k] = d_s->v[l][k] + (i ? before * m->stage[0][g].v[l][k] : (vector){0});
      }
    for (int e = 0; e < NLEV; e++)
      for (int k = 0; k < NEDGE; k++) d->y[e][k] = d_s->y_edges[e][k] + (i ? before * m->stage[0][g].y[e][k] : (vector){0});
    differentiate(m, w, g, t, step, m->d_a[g][i], d, v_0);
  }
  return 0;
}

/* A step of length h from its two stages. */
static void step_along(stepper *m, double h) {
  for (int g = 0; g < m->groups; g++) {
    lane_rates *first = m->stage[0] + g, *second = m->stage[1] + g;
    tangent *d = m->d + g;
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) { d->x[l][k] += h / 2 * (first->x[l][k] + second->x[l][k]); d->v[l][k] += h / 2 * (first->v[l][k] + second->v[l][k]); }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) d->y_edges[e][k] += h / 2 * (first->y[e][k] + second->y[e][k]);
  }
}

/* Directions of the equilibrium under the inputs at time t. */
static void begin_along(stepper *m, double t) {
  for (int g = 0; g < m->groups; g++) {
    memset(m->d + g, 0, sizeof m->d[g]);
    look_along(&m->motion.inputs, t, 0, 0, NU, NOTHING, g, m->d[g].u);
  }
}
static int rest_along(stepper *m, work *w, const state *s, double t) {
  if (!m->groups) return 0;
  memcpy(w->x, s->x, sizeof w->x);
  memcpy(w->v, s->v, sizeof w->v);
  memcpy(w->y, s->y_edges, sizeof w->y);
  if (linearise(m, w, 0, w->a, 1)) return 1;
  for (int g = 0; g < m->groups; g++) {
    lane_rates *d = m->stage[0] + g;
    memset(d, 0, sizeof *d);
    differentiate(m, w, g, t, 0, m->d[g].a, d, w->v);
    memcpy(m->d[g].x, d->x, sizeof d->x);
  }
  return 0;
}

/* Row k of what is observed along the directions d, at levels x. */
static void record_along(stepper *m, work *w, const double **arg, const tangent *d, long k) {
  if (!m->groups) return;
  double *by = w->in_directions.observed_by, *res_by[] = {by};
  run(observe_by, arg, res_by);
  for (int g = 0; g < m->groups; g++) {
    vector *out = m->motion.records.d_observed + (k * m->groups + g) * NOBS, *in = w->in_directions.x;
    memcpy(in, d[g].x, (NLEV + 1) * NB * sizeof(vector));
    memcpy(in + (NLEV + 1) * NB, m->motion.inputs.d_theta + g * NTHETA, NTHETA * sizeof(vector));
    memset(out, 0, NOBS * sizeof(vector));
    add_terms(m->changes[g].by_observed, m->changes[g].observed, by, in, out);
  }
}
