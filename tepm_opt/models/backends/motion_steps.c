/* Acceleration to expect of a stage: extrapolated from the same stage of the steps before, as the part that keeps lengths alternates
   between the stages; that of the latest stage where there are none. */
static void expect(const past *p, const levels latest, double t, levels a) {
  memcpy(a, p->known ? p->acceleration[0] : latest, sizeof(levels));
  if (p->known < 2) return;
  double part = (t - p->time[0]) / (p->time[0] - p->time[1]);
  for (int l = 1; l <= NLEV; l++) for (int k = 0; k < NB; k++) a[l][k] += part * (p->acceleration[0][l][k] - p->acceleration[1][l][k]);
}

static void keep(past *p, double t, levels a) {
  p->time[1] = p->time[0];
  memcpy(p->acceleration[1], p->acceleration[0], sizeof(levels));
  p->time[0] = t;
  memcpy(p->acceleration[0], a, sizeof(levels));
  p->known = fmin(p->known + 1, 2);
}

/* Crouzeix's two-stage SDIRK of order 3 (Hairer and Wanner, vol. II, IV.6): one step of length h from t, its iterations started
   from what `guide` expects; s is left alone on failure. */
static int implicit_step(stepper *m, work *w, state *s, const state *guide, double t, double h, int last_try) {
  const double gamma = 0.5 + sqrt(3) / 6, step = gamma * h, c[3] = {1 - gamma, gamma, 1};
  double a[2][NU];
  state start = *s;
  levels x_0, v_0, V[2], A[2];
  double Y[2][NLEV][AT_LEAST_1(NEDGE)];
  tangent *kept = 0;
  vector (*d_a)[2][NU] = 0;
  if (m->groups) {
    kept = malloc(m->groups * sizeof *kept);
    d_a = malloc(m->groups * sizeof *d_a);
    memcpy(kept, m->d, m->groups * sizeof *kept);
  }
  for (int k = 0; k < 3; k++) { /* the second stage's time comes first */
    move_inputs(m, w, s, t + c[k] * h, (c[k] - (k ? c[k - 1] : 0)) * h, k == 2);
    if (k == 2) break;
    memcpy(a[1 - k], w->a, sizeof w->a);
    for (int g = 0; g < m->groups; g++) memcpy(d_a[g][1 - k], m->d[g].a, sizeof m->d[g].a);
  }
  int status = SOLVED;
  for (int i = 0; i < 2 && !status; i++) {
    double before = i ? (1 - 2 * gamma) * h : 0;
    set_properties(m, w, a[i], t + c[1 - i] * h);
    memcpy(w->x[0], w->level_0, sizeof w->level_0);
    expect(guide->past + i, s->acceleration, t + c[1 - i] * h, A[i]);
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) {
        x_0[l][k] = s->x[l][k] + before * (i ? V[0][l][k] : 0);
        v_0[l][k] = s->v[l][k] + before * (i ? A[0][l][k] : 0);
        w->x[l][k] = x_0[l][k] + step * (v_0[l][k] + step * A[i][l][k]);
      }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) w->y[e][k] = s->y_edges[e][k] + before * (i ? Y[0][e][k] : 0);
    status = newton(m, w, step, x_0, v_0, last_try);
    if (status) break;
    memcpy(w->trusted, w->pull, sizeof w->pull);
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) { V[i][l][k] = w->v[l][k]; s->acceleration[l][k] = A[i][l][k] = (w->v[l][k] - v_0[l][k]) / step; }
    memcpy(Y[i], w->rate, sizeof Y[i]);
    keep(s->past + i, t + c[1 - i] * h, A[i]);
    if (!m->groups) continue;
    forces(w, step, 0); /* the pulls at the solution, for the exact matrix */
    memcpy(w->trusted, w->pull, sizeof w->pull);
    if (assemble(m, w, step) || linearise(w, step, a[i], 0)) { status = STUCK; break; }
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
      differentiate(m, w, g, t + c[1 - i] * h, step, d_a[g][i], d, v_0);
    }
  }
  if (status) {
    *s = start;
    if (kept) memcpy(m->d, kept, m->groups * sizeof *kept);
  } else {
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) { s->x[l][k] += h / 2 * (V[0][l][k] + V[1][l][k]); s->v[l][k] += h / 2 * (A[0][l][k] + A[1][l][k]); }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) s->y_edges[e][k] += h / 2 * (Y[0][e][k] + Y[1][e][k]);
    for (int g = 0; g < m->groups; g++) {
      lane_rates *first = m->stage[0] + g, *second = m->stage[1] + g;
      tangent *d = m->d + g;
      for (int l = 1; l <= NLEV; l++)
        for (int k = 0; k < NB; k++) { d->x[l][k] += h / 2 * (first->x[l][k] + second->x[l][k]); d->v[l][k] += h / 2 * (first->v[l][k] + second->v[l][k]); }
      for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) d->y_edges[e][k] += h / 2 * (first->y[e][k] + second->y[e][k]);
    }
  }
  free(kept);
  free(d_a);
  return status;
}

/* Classical RK4; inputs and their states at the start, the middle and the end. */
static int explicit_step(stepper *m, work *w, state *s, double t, double h) {
  static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
  state start = *s;
  levels V, A;
  double Y[NLEV][AT_LEAST_1(NEDGE)];
  for (int i = 0; i < 4; i++) {
    if (i == 1) move_inputs(m, w, s, t + h / 2, h / 2, 0);
    if (i == 3) move_inputs(m, w, s, t + h, h / 2, 1);
    if (i != 2) set_properties(m, w, w->a, t + at[i] * h);
    memcpy(w->x[0], w->level_0, sizeof w->level_0);
    for (int l = 1; l <= NLEV; l++)
      for (int k = 0; k < NB; k++) {
        w->x[l][k] = start.x[l][k] + (i ? at[i] * h * V[l][k] : 0);
        w->v[l][k] = start.v[l][k] + (i ? at[i] * h * A[l][k] : 0);
      }
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) w->y[e][k] = start.y_edges[e][k] + (i ? at[i] * h * Y[e][k] : 0);
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
    memcpy(Y, w->rate, sizeof Y);
    for (int e = 0; e < NLEV; e++) for (int k = 0; k < NEDGE; k++) s->y_edges[e][k] += weight[i] * h * Y[e][k];
  }
  return SOLVED;
}

static int bounded(state *s) {
  double sum = 0;
  for (int l = 1; l <= NLEV; l++) for (int i = 0; i < NB; i++) sum += fabs(s->x[l][i]);
  return sum < 1e3 * NLEV * NB;
}

/* A step, or two halves of it where Newton fails or the step before had to be halved twice. */
static int advance(stepper *m, work *w, state *s, double t, double h, int depth) {
  if (m->scheme == EXPLICIT) { m->steps++; m->longest = fmax(m->longest, h); return explicit_step(m, w, s, t, h); }
  if (s->depth <= depth + 1) {
    int status = implicit_step(m, w, s, s, t, h, depth == MAX_HALVINGS);
    if (!status) { m->steps++; m->longest = fmax(m->longest, h); s->depth = depth; return SOLVED; }
    if (depth == MAX_HALVINGS) return status;
    m->halvings++;
  }
  int status = advance(m, w, s, t, h / 2, depth + 1);
  return status ? status : advance(m, w, s, t + h / 2, h / 2, depth + 1);
}

typedef struct { double *observed, *trajectory; vector *d_observed; } records; /* what is left at the samples, row by row */

/* Row k of what is observed: points in G and lengths, levels and velocities, directions. */
static void record(stepper *m, work *w, levels x, levels v, const tangent *d, long k, const records *r) {
  const double *arg[] = {x[0], w->theta};
  double *res[] = {r->observed + k * NOBS, r->observed + k * NOBS + NOBS - NU / 2};
  run(observe, w, arg, res);
  memcpy(r->trajectory + k * 2 * sizeof(levels) / sizeof(double), x, sizeof(levels));
  memcpy(r->trajectory + (k * 2 + 1) * sizeof(levels) / sizeof(double), v, sizeof(levels));
  if (!m->groups) return;
  double by[observe_by_nnz], *res_by[] = {by};
  run(observe_by, w, arg, res_by);
  for (int g = 0; g < m->groups; g++) {
    vector *out = r->d_observed + (k * m->groups + g) * NOBS, in[(NLEV + 1) * NB + NTHETA];
    memcpy(in, d[g].x, (NLEV + 1) * NB * sizeof(vector));
    memcpy(in + (NLEV + 1) * NB, m->inputs->d_theta + g * NTHETA, NTHETA * sizeof(vector));
    memset(out, 0, NOBS * sizeof(vector));
    for (int i = 0; i < observe_by_nnz; i++) out[observe_by_row[i]] += by[i] * in[observe_by_col[i]];
  }
}

/* Rest under the first row: actuation, level 0, directions; s holds the equilibrium's levels. */
static int begin(stepper *m, work *w, state *s) {
  look(m->inputs, m->inputs->time[0], 0, 0, NU, s->u);
  for (int g = 0; g < m->groups; g++) {
    memset(m->d + g, 0, sizeof m->d[g]);
    look_along(m->inputs, m->inputs->time[0], 0, 0, NU, 0, g, m->d[g].u);
  }
  move_inputs(m, w, s, m->inputs->time[0] + m->inputs->delay, JUMP_TIME, 0);
  set_properties(m, w, w->a, m->inputs->time[0]);
  memcpy(s->x[0], w->level_0, sizeof w->level_0);
  if (!m->groups) return SOLVED;
  memcpy(w->x, s->x, sizeof w->x);
  memcpy(w->v, s->v, sizeof w->v);
  memcpy(w->y, s->y_edges, sizeof w->y);
  if (linearise(w, 0, w->a, 1)) return STUCK;
  for (int g = 0; g < m->groups; g++) {
    lane_rates *d = m->stage[0] + g;
    memset(d, 0, sizeof *d);
    differentiate(m, w, g, m->inputs->time[0], 0, m->d[g].a, d, w->v);
    memcpy(m->d[g].x, d->x, sizeof d->x);
  }
  return SOLVED;
}


/* To just after a jump of the inputs, where they hold; what was expected of the accelerations is void. */
static void jump(stepper *m, work *w, state *s, double t) {
  move_inputs(m, w, s, t, JUMP_TIME, 0);
  s->past[0].known = s->past[1].known = 0;
}
