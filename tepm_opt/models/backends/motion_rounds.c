/* The edges' pulls where the motion stands, and w->a where its inputs stand. */
static void take_stock(stepper *m, work *w, const state *s) {
  double *y = w->in_inputs.y, *zero = w->in_inputs.rate, *a = w->in_inputs.a, moment = JUMP_TIME, t = m->motion.t;
  memset(zero, 0, NU * sizeof(double));
  tell(m, w, t);
  const double *now[] = {s->u, zero, s->y_inputs, &moment, w->theta};
  double *result[] = {a, y};
  run(input_motion, now, result);
  memcpy(w->a, a, sizeof w->a);
  set_properties(m, w, w->a, t);
  memcpy(w->x, s->x, sizeof w->x);
  memcpy(w->v, s->v, sizeof w->v);
  memcpy(w->y, s->y_edges, sizeof w->y);
  forces(w, 0, 0);
  trust(w);
}

/* Moves on by a step of the ones of equal length between two samples, or, where Newton fails or the step before had to be halved twice,
   by a part of it. */
static void step_equally(stepper *m, work *w, carried *c, pair *p) {
  motion *o = &m->motion;
  const double *time = o->inputs.time + o->sample - 1, span = time[1] - time[0];
  int jumps = 0;
  if (!o->count) {
    o->count = (long)ceil(span / o->span * (1 - 1e-9));
    jumps = o->inputs.hold;
  }
  for (; c->fine.depth > o->depth + 1; o->depth++) o->part *= 2;
  double h = span / o->count;
  p->h = ldexp(h, -o->depth);
  p->t = time[0] + o->step * span / o->count + o->part * p->h;
  if (jumps) jump(m, w, &c->fine, p->t);
  if (m->scheme == EXPLICIT) explicit_step(m, w, &c->fine, p->t, p->h);
  else {
    p->start.fine = c->fine;
    copy(m, p->d_fine, m->d);
    if (implicit_step(m, w, &c->fine, &c->fine, p->t, p->h, o->depth == MAX_HALVINGS)) {
      c->fine = p->start.fine;
      copy(m, m->d, p->d_fine);
      if (o->depth == MAX_HALVINGS) { o->status = STUCK; o->phase = OVER; return; }
      m->halvings++;
      o->depth++;
      o->part *= 2;
      return;
    }
  }
  m->steps++;
  m->longest = fmax(m->longest, p->h);
  c->fine.depth = o->depth;
  for (o->part++; o->depth && o->part % 2 == 0; o->depth--) o->part /= 2;
  if (o->depth) return;
  o->part = 0;
  o->step++;
  if (!bounded(&c->fine)) { o->status = DIVERGED; o->phase = OVER; return; }
  m->reached = o->t = time[0] + o->step * (time[1] - time[0]) / o->count;
  if (o->step < o->count) return;
  o->t = time[1];
  o->count = o->step = 0;
  record(m, w, c->fine.x, c->fine.v, m->d);
}

/* Moves on, a step or two at a time, until the motion is over. */
static void move_on(stepper *m, work *w, carried *c, pair *p) {
  motion *o = &m->motion;
  while (o->phase != OVER) {
    const int beginning = o->phase == TO_BEGIN, pausing = o->phase != MOVING;
    o->phase = MOVING;
    if (beginning) {
      if (begin(m, w, &c->fine)) { o->status = STUCK; o->phase = OVER; return; }
      record(m, w, c->fine.x, c->fine.v, m->d);
      c->coarse = c->fine;
      copy(m, m->d_coarse, m->d_fine);
      c->step = FIRST_STEP;
      c->ratio = 1;
    }
    if (pausing) take_stock(m, w, &c->fine);
    if (m->adaptive) adapt(m, w, c, p);
    else step_equally(m, w, c, p);
    if (o->phase == MOVING && o->sample > *o->ends) {
      if (--o->ends_left) { o->ends++; o->phase = TO_TAKE_STOCK; }
      else { o->status = SOLVED; o->phase = OVER; }
    }
  }
}
