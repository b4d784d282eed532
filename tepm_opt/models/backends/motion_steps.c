/* Inputs or forces at times of their own. */
static void look(stepper *m, real t, int left, int from, int count, real *values) {
  for (int lane = 0; lane < WIDTH; lane++) {
    history *h = &m->motion[lane].inputs;
    if (!h->rows) continue;
    double part = place(h, LANE(t, lane), left);
    const double *row = h->rows + h->at * NINPUT + from;
    for (int k = 0; k < count; k++) LANE(values[k], lane) = row[k] + part * (row[NINPUT + k] - row[k]);
  }
}

#ifdef CLOCK
/* From now on kernels know that it is this time. */
static void tell(stepper *m, work *w, real t) {
  for (int lane = 0; lane < WIDTH; lane++) {
    const history *h = &m->motion[lane].inputs;
    if (h->rows) LANE(w->theta[CLOCK], lane) = LANE(w->theta[BEGAN], lane) + (LANE(t, lane) - h->time[0]);
  }
  know_time(w);
}
#else
#define tell(m, w, t) ((void)0)
#endif

/* When what acts at a time was commanded, or when forces that act then are known of; not inlined, so that the time is rounded alike
   wherever that is asked. */
static __attribute__((noinline)) real known_at(stepper *m, work *w, real t, int what) {
  real late = ZERO;
#ifdef CLOCK
  real both[2];
  const real *arg[] = {w->theta};
  real *res[] = {both};
  tell(m, w, t);
  CALL(delay, w, arg, res);
  for (int k = 0; k < 2; k++) for (int lane = 0; lane < WIDTH; lane++) m->motion[lane].inputs.delay[k] = LANE(both[k], lane);
#endif
  for (int lane = 0; lane < WIDTH; lane++) LANE(late, lane) = m->motion[lane].inputs.delay[what];
  return t - late;
}

/* Move the inputs, those of the time `at`, and their internal states on, and w->a with them. */
static void move_inputs(stepper *m, work *w, state *s, real at, real duration, int left, mask on) {
  const real often = 1 / duration;
  real *u = w->in_inputs.u, *rate = w->in_inputs.rate, *y = w->in_inputs.y, *a = w->in_inputs.a;
  memset(u, 0, NU * sizeof(real));
  look(m, at, left, 0, NU, u);
  for (int k = 0; k < NU; k++) rate[k] = (u[k] - s->u[k]) * often;
  const real *arg[] = {u, rate, s->y_inputs, &duration, w->theta};
  real *res[] = {a, y};
  CALL(input_motion, w, arg, res);
  move_inputs_along(m, w, arg, at, duration, left);
  blend(w->a, a, sizeof w->a, on);
  blend(s->u, u, sizeof s->u, on);
  blend(s->y_inputs, y, NIN * sizeof(real), on);
}

/* P and level 0 under the actuation a and the external forces at a time. */
static void set_properties(stepper *m, work *w, const real *a, real t) {
  look(m, known_at(m, w, t, FORCES), 0, NU, NEXT, w->external);
  const real *arg[] = {a, w->external, w->theta};
  real *res[] = {w->P[0], w->level_0};
  CALL(properties, w, arg, res);
  pack(w);
}

/* Acceleration to expect of a stage: extrapolated from the same stage of the steps before, as the part that keeps lengths alternates
   between the stages; that of the latest stage where there are none. */
static void expect(const past *p, const levels latest, real t, levels a) {
  mask none = WHERE(p->known < 1), two = WHERE(p->known > 1);
  real part = pick(two, (t - p->time[0]) / (p->time[0] - p->time[1]), ZERO);
  for (int l = 1; l <= NLEV; l++)
    for (int k = 0; k < NB; k++)
      a[l][k] = pick(none, latest[l][k], p->acceleration[0][l][k] + part * (p->acceleration[0][l][k] - p->acceleration[1][l][k]));
}

static void keep(past *p, real t, levels a) {
  p->time[1] = p->time[0];
  memcpy(p->acceleration[1], p->acceleration[0], sizeof(levels));
  p->time[0] = t;
  memcpy(p->acceleration[0], a, sizeof(levels));
  p->known = pick(WHERE(p->known < 1), each(1), each(2));
}

/* Crouzeix's two-stage SDIRK of order 3 (Hairer and Wanner, vol. II, IV.6): one step of length h from t, its iterations started
   from what `guide` expects; returns where that failed, which leaves s unfit. */
static mask implicit_step(stepper *m, work *w, state *s, const state *guide, real t, real h, mask last_try, mask on) {
  const double gamma = 0.5 + sqrt(3) / 6, c[3] = {1 - gamma, gamma, 1};
  const real step = gamma * h, rate = 1 / step;
  real (*a)[NU] = w->in_step.a, (*x_0)[NB] = w->in_step.x_0, (*v_0)[NB] = w->in_step.v_0;
  levels *V = w->in_step.V, *A = w->in_step.A;
  edge_states *Y = w->in_step.Y;
  mask failed = NONE;
  for (int k = 0; k < 3; k++) { /* the second stage's time comes first */
    move_inputs(m, w, s, known_at(m, w, t + c[k] * h, COMMANDS), (c[k] - (k ? c[k - 1] : 0)) * h, k == 2, on);
    if (k == 2) break;
    memcpy(a[1 - k], w->a, sizeof w->a);
    keep_actuation_along(m, 1 - k);
  }
  for (int i = 0; i < 2; i++) {
    const real before = (i ? 1 - 2 * gamma : 0) * h, at = t + c[1 - i] * h;
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
    failed |= newton(m, w, step, x_0, v_0, last_try, on & ~failed);
    if (!any(on & ~failed)) return failed;
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) { V[i][l][k] = w->v[l][k]; s->acceleration[l][k] = A[i][l][k] = (w->v[l][k] - v_0[l][k]) * rate; }
    memcpy(Y[i], w->rate, sizeof Y[i]);
    keep(s->past + i, at, A[i]);
    if (any(stage_along(m, w, i, at, step, before, a[i], v_0))) return on;
  }
  for (int l = 1; l <= NLEV; l++)
    for (int k = 0; k < NB; k++) { s->x[l][k] += h / 2 * (V[0][l][k] + V[1][l][k]); s->v[l][k] += h / 2 * (A[0][l][k] + A[1][l][k]); }
  for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) s->y_edges[e][k] += h / 2 * (Y[0][e][k] + Y[1][e][k]);
  step_along(m, h);
  return failed;
}

/* Classical RK4; inputs and their states at the start, the middle and the end. */
static void explicit_step(stepper *m, work *w, state *s, real t, real h, mask on) {
  static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
  real (*V)[NB] = w->in_step.V[0], (*A)[NB] = w->in_step.A[0];
  real (*Y)[AT_LEAST_1(NEDGE)] = w->in_step.Y[0];
  const state *start = &w->in_step.start;
  w->in_step.start = *s;
  for (int i = 0; i < 4; i++) {
    if (i == 1) move_inputs(m, w, s, known_at(m, w, t + h / 2, COMMANDS), h / 2, 0, on);
    if (i == 3) move_inputs(m, w, s, known_at(m, w, t + h, COMMANDS), h / 2, 1, on);
    if (i != 2) set_properties(m, w, w->a, t + at[i] * h);
    memcpy(w->x[0], w->level_0, sizeof w->level_0);
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) {
        w->x[l][k] = i ? start->x[l][k] + at[i] * h * V[l][k] : start->x[l][k];
        w->v[l][k] = i ? start->v[l][k] + at[i] * h * A[l][k] : start->v[l][k];
      }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) w->y[e][k] = i ? start->y_edges[e][k] + at[i] * h * Y[e][k] : start->y_edges[e][k];
    forces(w, ZERO, 0);
    for (int l = 1; l <= NLEV; l++) {
      real compliance = -1 / w->P[l - 1][MASS];
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

static mask bounded(const state *s) {
  real sum = ZERO;
  for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) sum += absolute(s->x[l][i]);
  return WHERE(sum < 1e3 * NLEV * NB);
}

/* The next row of what is observed: points in G and lengths, levels and velocities, directions. */
static void record(stepper *m, work *w, levels x, levels v, const tangent *d, mask on) {
  real now = ZERO;
  for (int lane = 0; lane < WIDTH; lane++) if (LANE(on, lane)) LANE(now, lane) = m->motion[lane].inputs.time[m->motion[lane].sample];
  tell(m, w, now);
  real *observed = w->in_record.observed;
  const real *arg[] = {x[0], w->theta};
  real *res[] = {observed, observed + NOBS - NU / 2};
  CALL(observe, w, arg, res);
  for (int lane = 0; lane < WIDTH; lane++) {
    if (!LANE(on, lane)) continue;
    motion *o = m->motion + lane;
    double *row = o->records.observed + o->sample * NOBS, *place = o->records.trajectory + o->sample * 2 * (NLEV + 1) * NB;
    for (int k = 0; k < NOBS; k++) row[k] = LANE(observed[k], lane);
    for (int l = 0; l <= NLEV; l++) for (int k = 0; k < NB; k++) *place++ = LANE(x[l][k], lane);
    for (int l = 0; l <= NLEV; l++) for (int k = 0; k < NB; k++) *place++ = LANE(v[l][k], lane);
    record_along(m, w, (const double **)arg, d, o->sample);
    o->sample++;
  }
}

/* Rest under the first row: actuation, level 0, directions; s holds the equilibrium's levels. Returns where that failed. */
static mask begin(stepper *m, work *w, state *s, mask on) {
  real t = ZERO, *u = w->in_inputs.u;
  memset(u, 0, NU * sizeof(real));
  for (int lane = 0; lane < WIDTH; lane++) {
    history *h = &m->motion[lane].inputs;
    if (h->rows) LANE(t, lane) = h->time[0];
  }
  look(m, t, 0, 0, NU, u);
  blend(s->u, u, sizeof s->u, on);
  begin_along(m, t);
  tell(m, w, t);
  move_inputs(m, w, s, t, each(JUMP_TIME), 0, on);
  set_properties(m, w, w->a, t);
  blend(s->x[0], w->level_0, sizeof w->level_0, on);
  return rest_along(m, w, s, t);
}

/* To just after a jump of the inputs, where they hold; what was expected of the accelerations is void. */
static void jump(stepper *m, work *w, state *s, real t, mask on) {
  move_inputs(m, w, s, known_at(m, w, t, COMMANDS), each(JUMP_TIME), 0, on);
  for (int i = 0; i < 2; i++) s->past[i].known = pick(on, ZERO, s->past[i].known);
}
