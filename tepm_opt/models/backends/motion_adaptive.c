/* Adaptive implicit steps. A fine motion takes two steps where a coarse one, never set right by it, takes one twice as long: their
   difference over 7 (Richardson's, order 3) is the error of the fine one, over all that was simulated. It is stated, and taken away
   from the result, which is then better than that. What a pair of steps adds to it decides about the length of the next. */

typedef struct { /* what is carried from call to call; steps that do not adapt only have `fine` */
  state fine, coarse;
  double step, ratio, error, moved; /* s to try next, what the last pair added over what it may, largest error and way of a pair in m */
} carried;

/* Cubic through positions and velocities at the ends of a span of length h, at a part of it; x and v += scale times that. */
#define HERMITE(name, type)                                                                                                          \
  static void name(type (*x_0)[NB], type (*v_0)[NB], type (*x_1)[NB], type (*v_1)[NB], double h, double part, double scale,           \
                   type (*x)[NB], type (*v)[NB]) {                                                                                   \
    double p = part, q = 1 - p, at[4] = {q * q * (1 + 2 * p), p * p * (1 + 2 * q), h * p * q * q, -h * q * p * p};                    \
    double rate[3] = {-6 * p * q / h, q * (1 - 3 * p), p * (1 - 3 * q)};                                                             \
    for (int l = 0; l <= NLEV; l++)                                                                                                  \
      for (int k = 0; k < NB; k++) {                                                                                                 \
        x[l][k] += scale * (at[0] * x_0[l][k] + at[1] * x_1[l][k] + at[2] * v_0[l][k] + at[3] * v_1[l][k]);                           \
        v[l][k] += scale * (rate[0] * (x_0[l][k] - x_1[l][k]) + rate[1] * v_0[l][k] + rate[2] * v_1[l][k]);                           \
      }                                                                                                                              \
  }
HERMITE(hermite, double)
HERMITE(hermite_lanes, vector)

typedef struct { /* a pair of steps of length h from t: where it starts, its middle and the directions there */
  carried start;
  state middle;
  tangent *d_fine, *d_middle, *d_coarse;
  double t, h;
} pair;

static void copy(stepper *m, tangent *to, const tangent *from) { if (m->groups) memcpy(to, from, m->groups * sizeof *to); }

/* Two steps of the fine motion and one of the coarse; all is left alone on failure. */
static int step_pair(stepper *m, work *w, carried *c, pair *p) {
  p->start = *c;
  copy(m, p->d_fine, m->d_fine);
  copy(m, p->d_coarse, m->d_coarse);
  m->d = m->d_fine;
  int status = implicit_step(m, w, &c->fine, &c->fine, p->t, p->h, 0);
  p->middle = c->fine;
  copy(m, p->d_middle, m->d_fine);
  if (!status) status = implicit_step(m, w, &c->fine, &c->fine, p->t + p->h, p->h, 0);
  m->d = m->d_coarse;
  if (!status) status = implicit_step(m, w, &c->coarse, &c->fine, p->t, 2 * p->h, 0);
  return status;
}

static void undo(stepper *m, carried *c, const pair *p) {
  *c = p->start;
  copy(m, m->d_fine, p->d_fine);
  copy(m, m->d_coarse, p->d_coarse);
}

/* Error in m, of the farthest node: at the end of a pair, what the pair has added to it (the part of its change that the difference of
   the velocities does not explain), and that of interpolating within its steps (a 16th of one over both, seen in their middle). */
typedef struct { double all, added, interpolated, moved; } errors; /* and how far the farthest node has moved */

static errors judge(const stepper *m, const carried *c, const pair *p) {
  errors e = {0};
  const state *a = &p->start.fine, *b = &c->fine;
  for (int l = 1; l <= NLEV; l++)
    for (int node = 0; node < NB; node += 3) {
      double added = 0, all = 0, interpolated = 0, moved = 0;
      for (int i = node; i < node + 3; i++) {
        double x = c->fine.x[l][i] - c->coarse.x[l][i], v = c->fine.v[l][i] - c->coarse.v[l][i];
        double x_0 = p->start.fine.x[l][i] - p->start.coarse.x[l][i], v_0 = p->start.fine.v[l][i] - p->start.coarse.v[l][i];
        double new = x - x_0 - p->h * (v + v_0);
        double off = (a->x[l][i] + b->x[l][i]) / 2 + p->h * (a->v[l][i] - b->v[l][i]) / 4 - p->middle.x[l][i];
        added += new * new;
        all += x * x;
        interpolated += off * off;
        moved += (b->x[l][i] - a->x[l][i]) * (b->x[l][i] - a->x[l][i]);
      }
      e = (errors){fmax(e.all, all), fmax(e.added, added), fmax(e.interpolated, interpolated), fmax(e.moved, moved)};
    }
  return (errors){sqrt(e.all) / m->divisor, sqrt(e.added) / m->divisor, sqrt(e.interpolated) / 16, sqrt(e.moved)};
}

/* State and directions at a time within a pair, with the estimated error taken away. */
static void between(stepper *m, carried *c, pair *p, double t, levels x, levels v, tangent *d) {
  double part = (t - p->t) / (2 * p->h), off = m->smooth ? 1. / RICHARDSON : 0, half = 2 * part - (part > 0.5);
  state *a = part > 0.5 ? &p->middle : &p->start.fine, *b = part > 0.5 ? &c->fine : &p->middle, *f = &p->start.fine, *z = &p->start.coarse;
  memset(x, 0, sizeof(levels));
  memset(v, 0, sizeof(levels));
  hermite(a->x, a->v, b->x, b->v, p->h, half, 1, x, v);
  hermite(f->x, f->v, c->fine.x, c->fine.v, 2 * p->h, part, off, x, v);
  hermite(z->x, z->v, c->coarse.x, c->coarse.v, 2 * p->h, part, -off, x, v);
  for (int g = 0; g < m->groups; g++) {
    tangent *a = (part > 0.5 ? p->d_middle : p->d_fine) + g, *b = (part > 0.5 ? m->d_fine : p->d_middle) + g;
    tangent *f = p->d_fine + g, *z = p->d_coarse + g, *f_1 = m->d_fine + g, *z_1 = m->d_coarse + g;
    memset(d + g, 0, sizeof *d);
    hermite_lanes(a->x, a->v, b->x, b->v, p->h, half, 1, d[g].x, d[g].v);
    hermite_lanes(f->x, f->v, f_1->x, f_1->v, 2 * p->h, part, off, d[g].x, d[g].v);
    hermite_lanes(z->x, z->v, z_1->x, z_1->v, 2 * p->h, part, -off, d[g].x, d[g].v);
  }
}

/* Length of the next two steps: the one wanted, or what ends them with equal ones at the stop. */
static double fitting(double wanted, double left) { return 2 * wanted > left * (1 - 1e-9) ? left / 2 : 4 * wanted > left ? left / 4 : wanted; }

/* Moves on from sample `first` to sample `last` so that the error stays about below `goal`; steps end at the knots. */
static int adapt(stepper *m, work *w, carried *c, long first, long last, double goal, const double *knots, long count, const records *r) {
  const double *time = m->inputs->time;
  double t = time[first];
  long knot = 0, sample = first + 1;
  int status = SOLVED;
  pair *p = malloc(sizeof *p);
  tangent *d = malloc(4 * m->groups * sizeof *d + 1);
  p->d_fine = d; p->d_middle = d + m->groups; p->d_coarse = d + 2 * m->groups;
  while (t < time[last]) {
    while (knot < count && knots[knot] < t - JUMP_TIME) knot++;
    if (knot < count && knots[knot] <= t + JUMP_TIME) {
      if (m->inputs->hold) {
        m->d = m->d_fine;
        jump(m, w, &c->fine, t);
        m->d = m->d_coarse;
        jump(m, w, &c->coarse, t);
        c->step = fmin(c->step, FIRST_STEP);
      }
      knot++;
    }
    double stop = knot < count && knots[knot] < time[last] ? knots[knot] : time[last], ratio = INFINITY;
    errors e = {0};
    p->t = t;
    p->h = fitting(c->step, stop - t);
    if (!(status = step_pair(m, w, c, p))) {
      e = judge(m, c, p);
      double moved = fmax(e.moved, p->start.moved * exp(-2 * p->h / STILL)), aim = fmin(goal, fmax(SHARE * moved, LEAST * goal)); /* small motions are resolved, too, so that estimates hold */
      c->moved = moved;
      ratio = fmax(fmax(e.added / sqrt(2 * p->h / MEMORY), e.interpolated) / aim, 1e-4);
    }
    if (!(ratio < MOST_OVER)) {
      undo(m, c, p);
      c->step = p->h * (status ? 0.5 : fmax(0.2, 0.8 * pow(ratio, -1. / 3)));
      m->halvings++;
      if (c->step < SHORTEST) { status = status ? status : STUCK; break; }
      continue;
    }
    m->steps += 2;
    m->longest = fmax(m->longest, p->h);
    double growth = p->h * fmin(4, fmax(0.3, 0.9 * pow(ratio, -0.25) * pow(c->ratio, 0.08))); /* PI control, Gustafsson 1991 */
    c->step = p->h < c->step ? fmax(c->step, growth) : growth; /* a step that a stop has shortened says little */
    c->ratio = ratio;
    c->error = fmax(fmax(c->error, LEAST * goal), e.all + e.interpolated);
    t = stop - t < 2 * p->h * (1 + 1e-9) ? stop : t + 2 * p->h;
    if (!bounded(&c->fine)) { status = DIVERGED; break; }
    m->reached = t;
    for (; sample <= last && time[sample] <= t + JUMP_TIME; sample++) {
      levels x, v;
      between(m, c, p, time[sample], x, v, d + 3 * m->groups);
      record(m, w, x, v, d + 3 * m->groups, sample, r);
    }
  }
  free(d);
  free(p);
  return status;
}
