/* The edges' pulls where motions stand, and w->a where their inputs stand. */
static void take_stock(stepper *m, work *w, const state *s, mask on) {
  real *y = w->in_inputs.y, *zero = w->in_inputs.rate, *a = w->in_inputs.a, moment = each(JUMP_TIME), t = ZERO;
  memset(zero, 0, NU * sizeof(real));
  for (int lane = 0; lane < WIDTH; lane++) if (LANE(on, lane)) LANE(t, lane) = m->motion[lane].t;
  tell(m, w, t);
  const real *now[] = {s->u, zero, s->y_inputs, &moment, w->theta};
  real *result[] = {a, y};
  CALL(input_motion, w, now, result);
  blend(w->a, a, sizeof w->a, on);
  set_properties(m, w, w->a, t);
  memcpy(w->x, s->x, sizeof w->x);
  memcpy(w->v, s->v, sizeof w->v);
  memcpy(w->y, s->y_edges, sizeof w->y);
  forces(w, ZERO, 0);
  trust(w, on);
}

/* Moves on by a step of the ones of equal length between two samples, or, where Newton fails or the step before had to be halved twice,
   by a part of it. */
static void step_equally(stepper *m, work *w, carried *c, pair *p, mask on) {
  mask jumps = NONE, last_try = jumps, failed = jumps, due = jumps;
  p->h = each(1);
  for (int lane = 0; lane < WIDTH; lane++) {
    motion *o = m->motion + lane;
    if (!LANE(on, lane)) continue;
    const double *time = o->inputs.time + o->sample - 1, span = time[1] - time[0];
    if (!o->count) {
      o->count = (long)ceil(span / o->span * (1 - 1e-9));
      LANE(jumps, lane) = -o->inputs.hold;
    }
    for (; LANE(c->fine.depth, lane) > o->depth + 1; o->depth++) o->part *= 2;
    double h = span / o->count, shorter = ldexp(h, -o->depth);
    LANE(p->t, lane) = time[0] + o->step * span / o->count + o->part * shorter;
    LANE(p->h, lane) = shorter;
    LANE(last_try, lane) = -(o->depth == MAX_HALVINGS);
  }
  if (any(jumps)) jump(m, w, &c->fine, p->t, jumps);
  if (m->scheme == EXPLICIT) explicit_step(m, w, &c->fine, p->t, p->h, on);
  else {
    p->start.fine = c->fine;
    copy(m, p->d_fine, m->d);
    failed = implicit_step(m, w, &c->fine, &c->fine, p->t, p->h, last_try, on);
    blend(&c->fine, &p->start.fine, sizeof c->fine, failed);
    if (any(failed)) copy(m, m->d, p->d_fine);
  }
  mask within = bounded(&c->fine);
  for (int lane = 0; lane < WIDTH; lane++) {
    motion *o = m->motion + lane;
    if (!LANE(on, lane)) continue;
    if (LANE(failed, lane)) {
      if (o->depth == MAX_HALVINGS) { o->status = STUCK; o->phase = OVER; continue; }
      LANE(m->halvings, lane) += 1;
      o->depth++;
      o->part *= 2;
      continue;
    }
    const double *time = o->inputs.time + o->sample - 1;
    LANE(m->steps, lane) += 1;
    LANE(m->longest, lane) = fmax(LANE(m->longest, lane), LANE(p->h, lane));
    LANE(c->fine.depth, lane) = o->depth;
    for (o->part++; o->depth && o->part % 2 == 0; o->depth--) o->part /= 2;
    if (o->depth) continue;
    o->part = 0;
    o->step++;
    if (!LANE(within, lane)) { o->status = DIVERGED; o->phase = OVER; continue; }
    LANE(m->reached, lane) = o->t = time[0] + o->step * (time[1] - time[0]) / o->count;
    if (o->step < o->count) continue;
    LANE(due, lane) = -1;
    o->t = time[1];
    o->count = o->step = 0;
  }
  if (any(due)) record(m, w, c->fine.x, c->fine.v, m->d, due);
}

/* Moves all motions on, a step or two at a time, until one of them is over, or for a number of rounds. */
static void move_on(stepper *m, work *w, carried *c, pair *p, long rounds) {
  for (int over = 0; !over && rounds; rounds--) {
    const mask none = NONE;
    mask beginning = none, pausing = none, on = none;
    for (int lane = 0; lane < WIDTH; lane++) {
      motion *o = m->motion + lane;
      if (o->phase == OVER) continue;
      LANE(on, lane) = -1;
      LANE(beginning, lane) = -(o->phase == TO_BEGIN);
      LANE(pausing, lane) = -(o->phase != MOVING);
      o->phase = MOVING;
    }
    if (any(beginning)) {
      mask failed = begin(m, w, &c->fine, beginning);
      record(m, w, c->fine.x, c->fine.v, m->d, beginning & ~failed);
      blend(&c->coarse, &c->fine, sizeof c->fine, beginning);
      copy(m, m->d_coarse, m->d_fine);
      c->step = pick(beginning, each(FIRST_STEP), c->step);
      c->ratio = pick(beginning, each(1), c->ratio);
      for (int lane = 0; lane < WIDTH; lane++)
        if (LANE(failed, lane)) { m->motion[lane].status = STUCK; m->motion[lane].phase = OVER; LANE(on, lane) = 0; }
    }
    if (any(pausing)) take_stock(m, w, &c->fine, pausing);
    if (!any(on)) return;
    if (m->adaptive) adapt(m, w, c, p, on);
    else step_equally(m, w, c, p, on);
    for (int lane = 0; lane < WIDTH; lane++) {
      motion *o = m->motion + lane;
      if (!LANE(on, lane)) continue;
      if (o->phase == MOVING && o->sample > *o->ends) {
        if (--o->ends_left) { o->ends++; o->phase = TO_TAKE_STOCK; }
        else { o->status = SOLVED; o->phase = OVER; }
      }
      over |= o->phase == OVER;
    }
  }
}
