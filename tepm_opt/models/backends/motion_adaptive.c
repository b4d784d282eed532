/* Adaptive implicit steps. A fine motion takes two steps where a coarse one, never set right by it, takes one twice as long: their
   difference over 7 (Richardson's, order 3) is the error of the fine one, over all that was simulated. It is stated, and taken away
   from the result, which is then better than that. What a pair of steps adds to it decides about the length of the next. */

typedef struct { /* a pair of steps of length h from t: where it starts, its middle and the directions there */
  carried start;
  state middle;
  tangent *d_fine, *d_middle, *d_coarse, *d_between;
  double t, h;
} pair;

static void hold_start(stepper *m, const carried *c, pair *p) {
  p->start = *c;
  copy(m, p->d_fine, m->d_fine);
  copy(m, p->d_coarse, m->d_coarse);
}

static void undo(stepper *m, carried *c, const pair *p) {
  *c = p->start;
  copy(m, m->d_fine, p->d_fine);
  copy(m, m->d_coarse, p->d_coarse);
}

/* Two steps of the fine motion and one of the coarse; returns whether they failed. */
static int step_pair(stepper *m, work *w, carried *c, pair *p) {
  hold_start(m, c, p);
  m->d = m->d_fine;
  if (implicit_step(m, w, &c->fine, &c->fine, p->t, p->h, 0)) return 1;
  p->middle = c->fine;
  copy(m, p->d_middle, m->d_fine);
  if (implicit_step(m, w, &c->fine, &c->fine, p->t + p->h, p->h, 0)) return 1;
  m->d = m->d_coarse;
  return implicit_step(m, w, &c->coarse, &c->fine, p->t, 2 * p->h, 0);
}

/* Error in m, of the farthest node: at the end of a pair, what the pair has added to it (the part of its change that the difference of
   the velocities does not explain), and that of interpolating within its steps (a 16th of one over both, seen in their middle). */
typedef struct { double all, added, interpolated, moved; } errors; /* and how far the farthest node has moved */

static errors judge(const stepper *m, const carried *c, const pair *p) {
  errors e = {};
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
      e = (errors){larger(e.all, all), larger(e.added, added), larger(e.interpolated, interpolated), larger(e.moved, moved)};
    }
  return (errors){sqrt(e.all) / m->divisor, sqrt(e.added) / m->divisor, sqrt(e.interpolated) / 16, sqrt(e.moved)};
}

/* Weights of positions and velocities at the start, the middle and the end of the fine motion, the start and the end of the coarse one. */
enum { START, MIDDLE, END, COARSE_START, COARSE_END, PLACES };
typedef struct { double x[PLACES], v[PLACES]; } weights;

/* Add the cubic through positions and velocities of two places that are h apart, at a part of the way, `scale` times: what it is made of,
   and its rate. */
static void add_cubic(weights *value, weights *rate, int from, int to, double h, double part, double scale) {
  double p = part, q = 1 - p, slope = scale * 6 * p * q / h;
  value->x[from] += scale * q * q * (1 + 2 * p);
  value->x[to] += scale * p * p * (1 + 2 * q);
  value->v[from] += scale * h * p * q * q;
  value->v[to] -= scale * h * q * p * p;
  rate->x[from] -= slope;
  rate->x[to] += slope;
  rate->v[from] += scale * q * (1 - 3 * p);
  rate->v[to] += scale * p * (1 - 3 * q);
}

#define WEIGH(name, type, Level)                                                                                               \
  static void name(const weights *by, const Level *const *x, const Level *const *v, Level *sum) {                                \
    for (int l = 0; l <= NLEV; l++)                                                                                             \
      for (int k = 0; k < NB; k++) {                                                                                            \
        type total = (type){0};                                                                                                 \
        for (int i = 0; i < PLACES; i++) total += by->x[i] * x[i][l][k] + by->v[i] * v[i][l][k];                                 \
        sum[l][k] = total;                                                                                                      \
      }                                                                                                                         \
  }
typedef double level[NB];
WEIGH(weigh, double, level)
typedef vector lane_level[NB];
WEIGH(weigh_lanes, vector, lane_level)
static void weigh_along(stepper *m, const weights *by, const pair *p) {
  for (int g = 0; g < m->groups; g++) {
    const tangent *d[] = {p->d_fine + g, p->d_middle + g, m->d_fine + g, p->d_coarse + g, m->d_coarse + g};
    const lane_level *x[PLACES], *v[PLACES];
    for (int i = 0; i < PLACES; i++) { x[i] = d[i]->x; v[i] = d[i]->v; }
    weigh_lanes(by, x, v, p->d_between[g].x);
  }
}

/* State and directions at a time within a pair, with the estimated error taken away. */
static void between(stepper *m, const carried *c, const pair *p, double t, levels x, levels v) {
  weights value = {}, rate = {};
  double part = (t - p->t) / (2 * p->h), late = part > 0.5 ? 1 : 0, off = m->smooth ? 1. / RICHARDSON : 0;
  add_cubic(&value, &rate, START, MIDDLE, p->h, 2 * part, 1 - late);
  add_cubic(&value, &rate, MIDDLE, END, p->h, 2 * part - 1, late);
  add_cubic(&value, &rate, START, END, 2 * p->h, part, off);
  add_cubic(&value, &rate, COARSE_START, COARSE_END, 2 * p->h, part, -off);
  const state *of[] = {&p->start.fine, &p->middle, &c->fine, &p->start.coarse, &c->coarse};
  const level *at[PLACES], *moving[PLACES];
  for (int i = 0; i < PLACES; i++) { at[i] = of[i]->x; moving[i] = of[i]->v; }
  weigh(&value, at, moving, x);
  weigh(&rate, at, moving, v);
  weigh_along(m, &value, p);
}

/* Length of the next two steps: the one wanted, or what ends them with equal ones at the stop. */
static double fitting(double wanted, double left) { return 2 * wanted > left * (1 - 1e-9) ? left / 2 : 4 * wanted > left ? left / 4 : wanted; }

/* Where the next pair of steps of a motion starts and how long it is; returns whether its inputs jump there. */
static int plan(motion *o, double *step, double *h) {
  const double last = o->inputs.time[*o->ends];
  int jumps = 0;
  while (o->knots_left && *o->knots < o->t - JUMP_TIME) { o->knots++; o->knots_left--; }
  while (o->knots_left && *o->knots <= o->t + JUMP_TIME) { /* commands and forces may jump at the same time, but for rounding */
    jumps = o->inputs.hold;
    if (jumps) *step = fmin(*step, FIRST_STEP);
    o->knots++;
    o->knots_left--;
  }
  o->stop = o->knots_left && *o->knots < last ? *o->knots : last;
  *h = fitting(*step, o->stop - o->t);
  return jumps;
}

/* Moves on by two steps, so that the error stays about below the goal; steps end at the knots. */
static void adapt(stepper *m, work *w, carried *c, pair *p) {
  motion *o = &m->motion;
  int jumps = plan(o, &c->step, &p->h);
  p->t = o->t;
  if (jumps) {
    m->d = m->d_fine;
    jump(m, w, &c->fine, p->t);
    m->d = m->d_coarse;
    jump(m, w, &c->coarse, p->t);
  }
  int failed = step_pair(m, w, c, p), within = bounded(&c->fine);
  errors e = judge(m, c, p);
  double h = p->h, moved = fmax(e.moved, p->start.moved * exp(-2 * h / STILL)), ratio = INFINITY;
  double aim = fmin(m->goal, fmax(SHARE * moved, LEAST * m->goal)); /* small motions are resolved, too, so that estimates hold */
  if (!failed) ratio = fmax(fmax(e.added / sqrt(2 * h / MEMORY), e.interpolated) / aim, 1e-4);
  double growth = h * fmin(4, fmax(0.3, 0.9 * pow(ratio, -0.25) * pow(c->ratio, 0.08))); /* PI control, Gustafsson 1991 */
  if (!(ratio < MOST_OVER)) {
    p->start.step = h * (failed ? 0.5 : fmax(0.2, 0.8 * pow(ratio, -1. / 3)));
    m->halvings++;
    if (p->start.step < SHORTEST) { o->status = STUCK; o->phase = OVER; }
    undo(m, c, p);
    return;
  }
  m->steps += 2;
  m->longest = fmax(m->longest, h);
  c->step = h < c->step ? fmax(c->step, growth) : growth; /* a step that a stop has shortened says little */
  c->ratio = ratio;
  c->moved = moved;
  c->error = fmax(fmax(c->error, LEAST * m->goal), e.all + e.interpolated);
  o->t = o->stop - o->t < 2 * h * (1 + 1e-9) ? o->stop : o->t + 2 * h;
  if (!within) { o->status = DIVERGED; o->phase = OVER; return; }
  m->reached = o->t;
  while (o->sample <= *o->ends && o->inputs.time[o->sample] <= o->t + JUMP_TIME) { /* samples passed */
    double (*x)[NB] = w->in_record.x, (*v)[NB] = w->in_record.v;
    between(m, c, p, o->inputs.time[o->sample], x, v);
    record(m, w, x, v, p->d_between);
  }
}
