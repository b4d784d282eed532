int state_size(void) { return sizeof(carried) / sizeof(double); }
int tangent_size(void) { return sizeof(tangent) / sizeof(double); }

/* Moves on from sample `first` to sample `last` of `samples`; rows first + 1 … last are recorded, and row 0 where `first` is 0. Steps are
   of at most `step`, or (`step` 0) such that the points err by about `goal`, ending at the `count` knots. s carries the state, d its
   directions (groups of the fine motion, then as many of the coarse one); info receives the fields of an Effort. */
int integrate(int scheme, int hold, long first, long last, long samples, const double *time, const double *rows, double step, double goal, int smooth,
              double tolerance, double max_correction, const double *theta, double *s, double *observed, double *trajectory, int groups,
              const double *d_theta, const double *d_rows, double *d, double *d_observed, const double *knots, long count, double *info) {
  work *w = aligned_alloc(64, (sizeof(work) + 63) / 64 * 64);
  pair *p = malloc(sizeof *p);
  tangent *kept = malloc(4 * groups * sizeof *kept + 1);
  lane_rates *rates = malloc(2 * groups * sizeof *rates + 1);
  vector (*d_a)[2][NU] = malloc(groups * sizeof *d_a + 1);
  changes *changed = malloc(groups * sizeof *changed + 1);
  int status = STUCK;
  if (w && p && kept && rates && d_a && changed) {
    memset(w, 0, sizeof *w);
    for (int k = 0; k < NTHETA; k++) w->packed_theta[k] = (vector){0} + (w->theta[k] = theta[k]);
    carried *c = (carried *)s;
    stepper m = {.scheme = scheme, .adaptive = !(step > 0), .groups = groups, .tolerance = tolerance, .max_correction = max_correction,
                 .goal = goal, .close = step > 0 ? 0 : CLOSE * goal, .smooth = smooth, .divisor = smooth ? RICHARDSON / 2. : 1,
                 .d = (tangent *)d, .d_fine = (tangent *)d, .d_coarse = (tangent *)d + groups,
                 .stage = {rates, rates + groups}, .d_a = d_a, .changes = changed, .reached = time[first]};
    motion *o = &m.motion;
    *o = (motion){.inputs = {.time = time, .rows = rows, .d_rows = (const vector *)d_rows, .samples = samples, .hold = hold,
                             .groups = groups, .d_theta = (const vector *)d_theta},
                  .records = {observed, trajectory, (vector *)d_observed}, .knots = knots, .knots_left = count, .ends = &last,
                  .ends_left = 1, .sample = first ? first + 1 : 0, .phase = first ? TO_TAKE_STOCK : TO_BEGIN, .t = time[first],
                  .span = step};
    *p = (pair){.d_fine = kept, .d_middle = kept + groups, .d_coarse = kept + 2 * groups, .d_between = kept + 3 * groups};
    if (groups) choose(&m, w);
    const double *arg[] = {theta};
    double *res[] = {o->inputs.delay}, *res_by[] = {o->inputs.by_delay};
    run(delay, arg, res);
    run(delay_by, arg, res_by);
    move_on(&m, w, c, p);
    status = o->status;
    const double effort[] = {m.steps, m.iterations, m.factors, m.halvings, m.reached, c->error, m.longest};
    memcpy(info, effort, sizeof effort);
  }
  free(changed);
  free(d_a);
  free(rates);
  free(kept);
  free(p);
  free(w);
  return status;
}
