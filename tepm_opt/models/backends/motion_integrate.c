int state_size(void) { return sizeof(carried) / sizeof(double); }
int tangent_size(void) { return sizeof(tangent) / sizeof(double); }

/* The edges' pulls where the motion stands, and w->a where the inputs stand. */
static void take_stock(stepper *m, work *w, const state *s, double t) {
  double y[AT_LEAST_1(NIN)];
  const double zero[NU] = {0}, moment = JUMP_TIME, *now[] = {s->u, zero, s->y_inputs, &moment, w->theta};
  double *a[] = {w->a, y};
  run(input_motion, w, now, a);
  set_properties(m, w, w->a, t);
  memcpy(w->x, s->x, sizeof w->x);
  memcpy(w->v, s->v, sizeof w->v);
  memcpy(w->y, s->y_edges, sizeof w->y);
  forces(w, 0, 0);
  memcpy(w->trusted, w->pull, sizeof w->pull);
}

/* Steps of equal length, at most `step`, between two samples. */
static int steps_to(stepper *m, work *w, carried *c, long k, double step, const records *r) {
  const double *time = m->inputs->time, span = time[k + 1] - time[k];
  int count = (int)ceil(span / step * (1 - 1e-9)), status = SOLVED;
  if (m->inputs->hold) jump(m, w, &c->fine, time[k]);
  for (int i = 0; i < count && !status; i++) {
    status = advance(m, w, &c->fine, time[k] + i * span / count, span / count, 0);
    if (!status && !bounded(&c->fine)) status = DIVERGED;
    if (!status) m->reached = time[k] + (i + 1) * span / count;
  }
  if (!status) record(m, w, c->fine.x, c->fine.v, m->d, k + 1, r);
  return status;
}

/* Moves on from sample `first` to sample `last` of `samples`; rows first + 1 … last are recorded, and row 0 where `first` is 0. Steps are
   of at most `step`, or (`step` 0) such that the points err by about `goal`, ending at the `count` knots. s carries the state, d its
   directions (groups of the fine motion, then as many of the coarse one); info receives the fields of an Effort. */
int integrate(int scheme, int hold, long first, long last, long samples, const double *time, const double *rows, double step, double goal, int smooth,
              double tolerance, double max_correction, const double *theta, double *s, double *observed, double *trajectory, int groups,
              const double *d_theta, const double *d_rows, double *d, double *d_observed, const double *knots, long count, double *info) {
  work *w = aligned_alloc(64, (sizeof(work) + 63) / 64 * 64);
  if (!w) return STUCK;
  memset(w, 0, sizeof *w);
  w->theta = theta;
  for (int k = 0; k < NTHETA; k++) w->packed_theta[k] = (vector){0} + theta[k];
  carried *c = (carried *)s;
  records r = {observed, trajectory, (vector *)d_observed};
  history inputs = {.time = time, .rows = rows, .d_rows = (const vector *)d_rows, .samples = samples, .hold = hold, .groups = groups,
                    .d_theta = (const vector *)d_theta};
  if (groups) choose(w, groups, inputs.d_theta);
  const double *arg[] = {theta};
  double *res[] = {&inputs.delay}, *res_by[] = {inputs.by_delay};
  run(delay, w, arg, res);
  run(delay_by, w, arg, res_by);
  stepper m = {.scheme = scheme, .groups = groups, .tolerance = tolerance, .max_correction = max_correction, .inputs = &inputs,
               .close = step > 0 ? 0 : CLOSE * goal, .smooth = smooth, .divisor = smooth ? RICHARDSON / 2. : 1, .d = (tangent *)d, .d_fine = (tangent *)d, .d_coarse = (tangent *)d + groups,
               .reached = time[first]};
  int status = SOLVED;
  for (int i = 0; i < 2 && groups; i++) m.stage[i] = malloc(groups * sizeof(lane_rates));
  if (!first && !(status = begin(&m, w, &c->fine))) {
    record(&m, w, c->fine.x, c->fine.v, m.d, 0, &r);
    c->coarse = c->fine;
    copy(&m, m.d_coarse, m.d_fine);
    c->step = FIRST_STEP;
    c->ratio = 1;
  }
  take_stock(&m, w, &c->fine, time[first]);
  if (step > 0)
    for (long k = first; k < last && !status; k++) status = steps_to(&m, w, c, k, step, &r);
  else if (!status)
    status = adapt(&m, w, c, first, last, goal, knots, count, &r);
  const double effort[] = {m.steps, m.iterations, m.factors, m.halvings, m.reached, c->error, m.longest};
  memcpy(info, effort, sizeof effort);
  for (int i = 0; i < 2; i++) free(m.stage[i]);
  free(w);
  return status;
}
