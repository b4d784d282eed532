/* Inputs or forces at a time. */
static void look(stepper *m, double t, int left, int from, int count, double *values) {
  history *h = &m->motion.inputs;
  double part = place(h, t, left);
  const double *row = h->rows + h->at * NINPUT + from;
  for (int k = 0; k < count; k++) values[k] = row[k] + part * (row[NINPUT + k] - row[k]);
}

#if TIMED
/* From now on kernels know that it is this time. */
static void tell(stepper *m, work *w, double t) {
  w->theta[CLOCK] = w->theta[BEGAN] + (t - m->motion.inputs.time[0]);
  know_time(w);
}
#else
#define tell(m, w, t) ((void)0)
#endif

/* When what acts at a time was commanded, or when forces that act then are known of; not inlined, so that the time is rounded alike
   wherever that is asked. */
static __attribute__((noinline)) double known_at(stepper *m, work *w, double t, int what) {
#if TIMED
  double both[2];
  const double *arg[] = {w->theta};
  double *res[] = {both};
  tell(m, w, t);
  run(delay, arg, res);
  memcpy(m->motion.inputs.delay, both, sizeof both);
#endif
  return t - m->motion.inputs.delay[what];
}

/* Move the inputs, those of the time `at`, and their internal states on, and w->a with them. */
static void move_inputs(stepper *m, work *w, state *s, double at, double duration, int left) {
  const double often = 1 / duration;
  double *u = w->in_inputs.u, *rate = w->in_inputs.rate, *y = w->in_inputs.y, *a = w->in_inputs.a;
  look(m, at, left, 0, NU, u);
  for (int k = 0; k < NU; k++) rate[k] = (u[k] - s->u[k]) * often;
  const double *arg[] = {u, rate, s->y_inputs, &duration, w->theta};
  double *res[] = {a, y};
  run(input_motion, arg, res);
  move_inputs_along(m, w, arg, at, duration, left);
  memcpy(w->a, a, sizeof w->a);
  memcpy(s->u, u, sizeof s->u);
  memcpy(s->y_inputs, y, NIN * sizeof(double));
}

/* P and level 0 under the actuation a and the external forces at a time. */
static void set_properties(stepper *m, work *w, const double *a, double t) {
  double external[AT_LEAST_1(NEXT)];
  look(m, known_at(m, w, t, FORCES), 0, NU, NEXT, external);
  if (!TIMED && w->has_properties && !memcmp(a, w->acting, sizeof w->acting) && !memcmp(external, w->external, NEXT * sizeof *external))
    return; /* inputs are held */
  w->has_properties = 1;
  memcpy(w->acting, a, sizeof w->acting);
  memcpy(w->external, external, NEXT * sizeof *external);
  const double *arg[] = {w->acting, w->external, w->theta};
  double *res[] = {w->P[0], w->level_0};
  run(properties, arg, res);
  pack(w);
}

/* Acceleration to expect of a stage: extrapolated from the same stage of the steps before, as the part that keeps lengths alternates
   between the stages; that of the latest stage where there are none. */
static void expect(const past *p, const levels latest, double t, levels a) {
  double part = p->known > 1 ? (t - p->time[0]) / (p->time[0] - p->time[1]) : 0;
  for (int l = 1; l <= NLEV; l++)
    for (int k = 0; k < NB; k++)
      a[l][k] = p->known < 1 ? latest[l][k] : p->acceleration[0][l][k] + part * (p->acceleration[0][l][k] - p->acceleration[1][l][k]);
}

static void keep(past *p, double t, levels a) {
  p->time[1] = p->time[0];
  memcpy(p->acceleration[1], p->acceleration[0], sizeof(levels));
  p->time[0] = t;
  memcpy(p->acceleration[0], a, sizeof(levels));
  p->known = p->known < 1 ? 1 : 2;
}

/* Crouzeix's two-stage SDIRK of order 3 (Hairer and Wanner, vol. II, IV.6): one step of length h from t, its iterations started
   from what `guide` expects; returns whether that failed, which leaves s unfit. */
static int implicit_step(stepper *m, work *w, state *s, const state *guide, double t, double h, int last_try) {
  const double gamma = 0.5 + sqrt(3) / 6, c[3] = {1 - gamma, gamma, 1};
  const double step = gamma * h, rate = 1 / step;
  double (*a)[NU] = w->in_step.a, (*x_0)[NB] = w->in_step.x_0, (*v_0)[NB] = w->in_step.v_0;
  levels *V = w->in_step.V, *A = w->in_step.A;
  edge_states *Y = w->in_step.Y;
  for (int k = 0; k < 3; k++) { /* the second stage's time comes first */
    move_inputs(m, w, s, known_at(m, w, t + c[k] * h, COMMANDS), (c[k] - (k ? c[k - 1] : 0)) * h, k == 2);
    if (k == 2) break;
    memcpy(a[1 - k], w->a, sizeof w->a);
    keep_actuation_along(m, 1 - k);
  }
  for (int i = 0; i < 2; i++) {
    const double before = (i ? 1 - 2 * gamma : 0) * h, at = t + c[1 - i] * h;
    set_properties(m, w, a[i], at);
    memcpy(w->x[0], w->level_0, sizeof w->level_0);
    expect(guide->past + i, s->acceleration, at, A[i]);
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) {
        x_0[l][k] = i ? s->x[l][k] + before * V[0][l][k] : s->x[l][k];
        v_0[l][k] = i ? s->v[l][k] + before * A[0][l][k] : s->v[l][k];
        w->x[l][k] = x_0[l][k] + step * (v_0[l][k] + step * A[i][l][k]);
      }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) w->y[e][k] = i ? s->y_edges[e][k] + before * Y[0][e][k] : s->y_edges[e][k];
    if (newton(m, w, step, x_0, v_0, last_try)) return 1;
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) { V[i][l][k] = w->v[l][k]; s->acceleration[l][k] = A[i][l][k] = (w->v[l][k] - v_0[l][k]) * rate; }
    memcpy(Y[i], w->rate, sizeof Y[i]);
    keep(s->past + i, at, A[i]);
    if (stage_along(m, w, i, at, step, before, a[i], v_0)) return 1;
  }
  for (int l = 1; l <= NLEV; l++)
    for (int k = 0; k < NB; k++) { s->x[l][k] += h / 2 * (V[0][l][k] + V[1][l][k]); s->v[l][k] += h / 2 * (A[0][l][k] + A[1][l][k]); }
  for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) s->y_edges[e][k] += h / 2 * (Y[0][e][k] + Y[1][e][k]);
  step_along(m, h);
  return 0;
}

/* Classical RK4; inputs and their states at the start, the middle and the end. */
static void explicit_step(stepper *m, work *w, state *s, double t, double h) {
  static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
  double (*V)[NB] = w->in_step.V[0], (*A)[NB] = w->in_step.A[0];
  double (*Y)[AT_LEAST_1(NEDGE)] = w->in_step.Y[0];
  const state *start = &w->in_step.start;
  w->in_step.start = *s;
  for (int i = 0; i < 4; i++) {
    if (i == 1) move_inputs(m, w, s, known_at(m, w, t + h / 2, COMMANDS), h / 2, 0);
    if (i == 3) move_inputs(m, w, s, known_at(m, w, t + h, COMMANDS), h / 2, 1);
    if (i != 2) set_properties(m, w, w->a, t + at[i] * h);
    memcpy(w->x[0], w->level_0, sizeof w->level_0);
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) {
        w->x[l][k] = i ? start->x[l][k] + at[i] * h * V[l][k] : start->x[l][k];
        w->v[l][k] = i ? start->v[l][k] + at[i] * h * A[l][k] : start->v[l][k];
      }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) w->y[e][k] = i ? start->y_edges[e][k] + at[i] * h * Y[e][k] : start->y_edges[e][k];
    forces(w, 0, 0);
    for (int l = 1; l <= NLEV; l++) {
      double compliance = -1 / w->P[l - 1][MASS];
      for (int k = 0; k < NB; k++) {
        V[l][k] = w->v[l][k];
        A[l][k] = compliance * w->force[l][k];
        s->x[l][k] += weight[i] * h * V[l][k];
        s->v[l][k] += weight[i] * h * A[l][k];
      }
    }
    memcpy(Y, w->rate, sizeof w->rate);
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) s->y_edges[e][k] += weight[i] * h * Y[e][k];
  }
}

static int bounded(const state *s) {
  double sum = 0;
  for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) sum += fabs(s->x[l][i]);
  return sum < 1e3 * NLEV * NB;
}

/* The next row of what is observed: points in G and lengths, levels and velocities, directions. */
static void record(stepper *m, work *w, levels x, levels v, const tangent *d) {
  motion *o = &m->motion;
  double *observed = w->in_record.observed, *row = o->records.observed + o->sample * NOBS;
  double *place = o->records.trajectory + o->sample * 2 * (NLEV + 1) * NB;
  tell(m, w, o->inputs.time[o->sample]);
  const double *arg[] = {x[0], w->theta};
  double *res[] = {observed, observed + NOBS - NU / 2};
  run(observe, arg, res);
  memcpy(row, observed, NOBS * sizeof(double));
  memcpy(place, x, sizeof(levels));
  memcpy(place + (NLEV + 1) * NB, v, sizeof(levels));
  record_along(m, w, arg, d, o->sample);
  o->sample++;
}

/* Rest under the first row: actuation, level 0, directions; s holds the equilibrium's levels. Returns whether that failed. */
static int begin(stepper *m, work *w, state *s) {
  double t = m->motion.inputs.time[0], *u = w->in_inputs.u;
  look(m, t, 0, 0, NU, u);
  memcpy(s->u, u, sizeof s->u);
  begin_along(m, t);
  tell(m, w, t);
  move_inputs(m, w, s, t, JUMP_TIME, 0);
  set_properties(m, w, w->a, t);
  memcpy(s->x[0], w->level_0, sizeof w->level_0);
  return rest_along(m, w, s, t);
}

/* To just after a jump of the inputs, where they hold; what was expected of the accelerations is void. */
static void jump(stepper *m, work *w, state *s, double t) {
  move_inputs(m, w, s, known_at(m, w, t, COMMANDS), JUMP_TIME, 0);
  for (int i = 0; i < 2; i++) s->past[i].known = 0;
}
