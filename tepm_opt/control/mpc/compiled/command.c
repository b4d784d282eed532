/* From a sample to the commands, and what is prepared before it. */

static double since(const struct timespec *began) {
  struct timespec now;
  timespec_get(&now, TIME_UTC);
  return (double)(now.tv_sec - began->tv_sec) + 1e-9 * (double)(now.tv_nsec - began->tv_nsec);
}

static double ranked(double *values, int count, int rank) {
  for (int low = 0, high = count - 1; low < high;) {
    double pivot = values[(low + high) / 2];
    int i = low, j = high;
    while (i <= j) {
      while (values[i] < pivot) i++;
      while (values[j] > pivot) j--;
      if (i <= j) { double kept = values[i]; values[i++] = values[j]; values[j--] = kept; }
    }
    if (rank <= j) high = j;
    else if (rank >= i) low = i;
    else break;
  }
  return values[rank];
}

/* Noise of the tracked points from their third differences, and what lasts of the gauges' offsets, by the last sample:
   diagnostics/sensors.py. */
static void note(step *o) {
  static const double third[] = {1, -3, 3, -1};
  const settings *s = &o->set;
  const actuators *a = &o->acts[o->now];
  double rough[NOISE_WINDOW * NY];
  int count = 0;
  if (o->noted == o->samples) return;
  o->noted = o->samples;
  for (int j = 0; j < NA; j++) {
    o->out.lasting_tension[j] = fabs(a->offset.tension[j]) > s->tension_off[j] ? o->out.lasting_tension[j] + 1 : 0;
    o->out.lasting_pressure[j] = fabs(a->offset.pressure[j]) > s->pressure_off[j] ? o->out.lasting_pressure[j] + 1 : 0;
  }
  for (int k = 0; k < 2 * NA; k++) { /* times that are declared over those found */
    int exhausts = k / NA, j = k % NA, known = a->covariance[exhausts][exhausts][j] < s->lag_known * s->lag_known && is_believed(o, a, j);
    double share = is_unmonitored(o, a, j) ? a->share[exhausts][j] : share_of(o, a, j, exhausts);
    double declared = exhausts ? s->exhausting : s->filling;
    o->out.quicker[k] = known ? log1p(-share) / log1p(-declared) : 1;
  }
  o->out.common[0] = 1;
  for (int j = 0; j < NA; j++) {
    o->out.monitor_noise[j] = is_noisy(o, a, j) ? a->noise[j] : 0;
    if (!is_believed(o, a, j)) o->out.common[0] = 1 / a->nearest_factor;
  }
  o->out.late[0] = (o->ahead - o->declared) * s->period + lateness(o, a);
  if (o->samples >= NOISE_WINDOW && o->samples % NOISE_EVERY == 0)
    for (int k = 0; k < NOISE_WINDOW - 3; k++)
      for (int i = 0; i < NY; i++) {
        double sum = 0;
        for (int c = 0; c < 4; c++) sum += third[c] * o->seen[(o->samples + k + c) % NOISE_WINDOW][i];
        if (isfinite(sum)) rough[count++] = fabs(sum);
      }
  if (count) {
    double middle = ranked(rough, count, count / 2);
    if (count % 2 == 0) middle = (middle + ranked(rough, count, count / 2 - 1)) / 2;
    o->measured = within(middle / 0.6745 / sqrt(20), s->slowest * s->declared_noise, s->largest * s->declared_noise);
  }
  o->out.noise[0] = o->measured;
  o->out.doubtful[0] = fabs(o->out.late[0]) > s->late_told || o->measured > s->noisy * s->declared_noise;
  for (int j = 0; j < NA; j++) o->out.doubtful[0] += o->out.lasting_tension[j] > s->stays || o->out.lasting_pressure[j] > s->stays;
  o->out.doubtful[0] += fabs(log(o->out.common[0])) > s->quicker_told;
  for (int j = 0; j < NA; j++) o->out.doubtful[0] += o->out.monitor_noise[j] > 0;
  for (int k = 0; k < 2 * NA; k++) o->out.doubtful[0] += fabs(log(o->out.quicker[k])) > s->quicker_told;
}

/* Prepares for a sample at a row. Returns 0, or 1 where the network cannot be linearised. */
static int prepare(step *o, long row) {
  filter *f = &o->filters[!o->now];
  actuators *a = &o->acts[!o->now];
  const settings *s = &o->set;
  const course *c = &o->way;
  double area[NA], forces[2][NA], slopes[2][NA], rates[NA], direction[NA];
  o->ready = 0;
  note(o);
  if (row > o->row + 2 && o->beyond.at) { o->last = *o->beyond.at; o->beyond.at = &o->last; } /* its place may be taken */
  if (o->corrected) { settle(o, &o->filters[o->now], &o->acts[o->now], &o->to_do); o->corrected = 0; }
  *f = o->filters[o->now];
  *a = o->acts[o->now];
  f->noise = o->measured;
  for (int j = 0; j < NA; j++) area[j] = s->area;
  for (long passed = o->row; passed < row; passed++) {
    const devices *command = acting(o, passed);
    devices was = a->told;
    for (int j = 0; j < NA; j++) slopes[0][j] = s->area * a->by_factor[j];
    slope_by_factor(o, a, command);
    for (int j = 0; j < NA; j++) slopes[1][j] = s->area * a->by_factor[j];
    advance(o, a, &a->now, command, area, forces);
    slope(a, command);
    advance(o, a, &a->told, command, area, 0);
    follow(a, command);
    const double *l = c->lengths + at_row(o, passed) * NA, *m = c->lengths + at_row(o, passed + 1) * NA;
    for (int j = 0; j < NA; j++) {
      a->rate[j] = (a->told.tension[j] - was.tension[j]) / s->period;
      rates[j] = (m[j] - l[j]) / s->period;
      forces[0][j] += a->extra[j];
      forces[1][j] += a->extra[j];
    }
    const operating *then = point(o, passed + 1);
    if (!then) return 1;
    predict(o, f, forces, slopes, a->now.tension, rates, then);
  }
  if (!f->at && !(f->at = point(o, row))) return 1;
  const operating *then = point(o, row + o->ahead);
  if (!then) return 1;
  seen_from(o, then, f->at, o->turn, o->shift);
  expect(f, &o->to_do);
  memcpy(direction, f->direction, sizeof direction);
  for (int k = 0; k < o->ahead; k++) {
    const double *l = c->lengths + at_row(o, row + k) * NA, *m = c->lengths + at_row(o, row + k + 1) * NA;
    for (int j = 0; j < NA; j++) {
      double change = m[j] - l[j] + s->period * f->deviation[j];
      o->directions[k][j] = direction[j] = dahl_step(direction[j], change, s->presliding);
    }
  }
  for (int k = 0; k < PREVIEW; k++) {
    long at = row + o->ahead + PERIODS * k;
    const double *l = c->lengths + at_row(o, at) * NA, *m = c->lengths + at_row(o, at + PERIODS) * NA;
    for (int j = 0; j < NA; j++) {
      o->courses[k][j] = direction[j] = dahl_step(direction[j], m[j] - l[j], s->presliding);
      o->foreseen[k][j] = f->mean[FRICTION + j] * direction[j];
      o->factor[k][j] = 1 + s->load_share / s->middle * o->foreseen[k][j];
    }
  }
  look_from(o, then, row + o->ahead);
  condense(o);
  take(&o->best, o->hessian, o->factor[0]);
  o->ready = 1;
  o->ready_row = row;
  return 0;
}

/* Pressures that a need of forces asks for: the new commands, and what they lead to at the coming stages. */
static void plan_pressures(step *o, const devices *acted, const double *area, const double *turning, const double *rest_force,
                           double still[PREVIEW][NA], double *pressures, double reached[STAGES][NA]) {
  const settings *s = &o->set;
  const horizon *h = &o->beyond;
  const double *now = o->sent[o->sents - 1].command.pressure, *mean = o->filters[o->now].mean;
  const actuators *a = &o->acts[o->now];
  double part = least(1, h->speed / s->full_feedback_speed);
  for (int j = 0; j < NA; j++) {
    double times[2] = {-s->period / log1p(-share_of(o, a, j, 0)), -s->period / log1p(-share_of(o, a, j, 1))};
    if (is_unmonitored(o, a, j)) for (int k = 0; k < 2; k++) times[k] = -s->period / log1p(-a->common[1][k]);
    double wanted[PREVIEW], lead[PREVIEW - WINDOW], direction = turning[j], before = 0, pressure = acted->pressure[j];
    o->slow[j] += s->slow_share * (mean[FORCE + j] - o->slow[j]);
    for (int k = 0; k < PREVIEW; k++) {
      double need = h->forces[k + 1][j] + h->dynamic[k][j] + rest_force[j];
      if (s->mid_ranging) {
        need -= o->slow[j];
        if (o->planned_there && k < STAGES) {
          double extra = o->planned[k][j] - rest_force[j] - h->dynamic[k][j];
          o->extra[k][j] += s->feedback_share * (extra - o->extra[k][j]);
          need += part * (STAGES > 1 ? 1 - k / (double)(STAGES - 1) : 1) * o->extra[k][j];
        }
      }
      double plain = (need - a->extra[j] + still[k][j] + o->factor[k][j] * s->rest_tension[j]) / area[j];
      direction = dahl_step(direction, k ? s->area * (plain - before) : 0, s->width);
      wanted[k] = plain + mean[HYSTERESIS + j] * direction / area[j];
      before = plain;
    }
    for (int k = 0; k < PREVIEW - WINDOW; k++) {
      double slope = (wanted[k + WINDOW] - wanted[k]) / (WINDOW * PERIODS * s->period);
      lead[k] = within((wanted[k + WINDOW] + wanted[k]) / 2 + times[!(slope > 0)] * slope, 0, o->set.pressure_max[j]);
    }
    pressures[j] = lead[0];
    if (s->grid > 0) {
      double steps = within(rint(lead[0] / s->grid), 0, floor(s->pressure_max[j] / s->grid * (1 + 1e-12)));
      double deadband = within(s->deadband * times[!(lead[0] > now[j])] / s->slow_lag, least(s->deadband, 1), s->deadband);
      pressures[j] = fabs(lead[0] - now[j]) > deadband * s->grid ? steps * s->grid : now[j];
    }
    for (int k = 0; k < STAGES; k++) {
      double goal = within(pressures[j] + lead[k < PREVIEW - WINDOW ? k : PREVIEW - WINDOW - 1] - lead[0], 0, s->pressure_max[j]);
      reached[k][j] = pressure = lagged(o, a, j, pressure, goal, PERIODS);
    }
  }
}

/* Pressures, then tensions that know them. */
static void decide(step *o, const double *motion, const devices *acted, const double *area, const double *turning,
                   const struct timespec *began, double deadline) {
  const settings *s = &o->set;
  const horizon *h = &o->beyond;
  const double *mean = o->filters[o->now].mean, *direction = o->directions[o->ahead - 1];
  outcome *out = &o->out;
  double rest_force[NA], rest[NQ], state[NX], still[PREVIEW][NA], reached[STAGES][NA], begin[NA], offset[STAGES][NA], g[STAGES][NA];
  double f[NV], low[2 * NV], high[2 * NV], x[NV];
  devices command;
  for (int j = 0; j < NA; j++) { rest_force[j] = 0; for (int k = 0; k < 3; k++) rest_force[j] += h->undo[j][k] * mean[NS - 3 + k]; }
  for (int i = 0; i < NQ; i++) {
    double sum = 0;
    for (int j = 0; j < NA; j++) sum += h->at->drive[i][j] * rest_force[j];
    rest[i] = sum / h->at->values[i];
    state[i] = motion[i];
    state[NQ + i] = motion[NQ + i] - h->rate[i];
  }
  for (int k = 0; k < PREVIEW; k++)
    for (int j = 0; j < NA; j++) still[k][j] = mean[FRICTION + j] * o->courses[k][j] - s->load_share * o->foreseen[k][j];
  plan_pressures(o, acted, area, turning, rest_force, still, command.pressure, reached);
  for (int j = 0; j < NA; j++) {
    double unknown = mean[FORCE + j] + o->acts[o->now].extra[j], friction = mean[FRICTION + j], hysteresis = mean[HYSTERESIS + j];
    double way = turning[j], before = acted->pressure[j];
    begin[j] = area[j] * acted->pressure[j] - acted->tension[j] + unknown - h->forces[0][j] - hysteresis * turning[j]
             - friction * direction[j] * loaded(o, acted->tension[j]);
    for (int k = 0; k < STAGES; k++) {
      way = dahl_step(way, s->area * (reached[k][j] - before), s->width);
      before = reached[k][j];
      offset[k][j] = area[j] * before - h->forces[k + 1][j] + unknown - still[k][j] - hysteresis * way;
    }
  }
  gradient(o, state, begin, offset, rest_force, rest, g);
  for (int k = 0; k < STAGES; k++)
    for (int j = 0; j < NA; j++) {
      int i = k * NA + j;
      f[i] = -o->factor[k][j] * g[k][j];
      low[i] = 0;
      high[i] = s->tension_max[j];
      low[NV + i] = -s->pull_stage;
      high[NV + i] = s->pull_stage;
      if (k) continue;
      double first = within(acted->tension[j], 0, s->tension_max[j]);
      low[i] = most(low[i], first - s->pull_stage);
      high[i] = least(high[i], first + s->pull_stage);
    }
  int iterations, status = minimise(&o->best, f, low, high, MOST_ITERATIONS, x, &iterations);
  if (!status && since(began) > deadline) status = LATE;
  for (int k = 0; k < STAGES; k++)
    for (int j = 0; j < NA; j++) {
      if (!status) {
        o->plan[k][j] = x[k * NA + j];
        o->planned[k][j] = offset[k][j] - o->factor[k][j] * o->plan[k][j];
      } else if (!o->plan_there) o->plan[k][j] = acted->tension[j];
      else o->plan[k][j] = within((o->plan[k][j] + o->plan[k < STAGES - 1 ? k + 1 : k][j]) / 2, 0, s->tension_max[j]);
    }
  o->planned_there = !status;
  o->plan_there = 1;
  out->moves[0] = 0;
  for (int j = 0; j < NA; j++) {
    out->moves[0] += command.pressure[j] != o->sent[o->sents - 1].command.pressure[j];
    command.tension[j] = within((acted->tension[j] + o->plan[0][j]) / 2, 0, s->tension_max[j]);
    out->pressures[j] = command.pressure[j];
    out->tensions[j] = command.tension[j];
    out->against[j] = mean[FORCE + j] + o->acts[o->now].extra[j] + s->area * mean[STRENGTH + j] * acted->pressure[j] - mean[FRICTION + j] * direction[j];
  }
  out->status[0] = status;
  out->iterations[0] = iterations;
  memcpy(out->plan, o->plan, sizeof out->plan);
}

/* What is told of the estimate. */
static void tell(step *o, const actuators *a) {
  const filter *f = &o->filters[o->now];
  outcome *out = &o->out;
  memcpy(out->state, f->mean, sizeof out->state);
  for (int k = 0; k < NY; k++) {
    double sum = f->at->points[k] + f->mean[BIAS + k];
    for (int i = 0; i < NQ; i++) sum += f->at->observe[k][i] * f->mean[i];
    out->points[k] = sum;
  }
  memcpy(out->direction, f->direction, sizeof out->direction);
  memcpy(out->turning, f->turning, sizeof out->turning);
  memcpy(out->deviation, f->deviation, sizeof out->deviation);
  memcpy(out->pressure_offset, a->offset.pressure, sizeof out->pressure_offset);
  memcpy(out->tension_offset, a->offset.tension, sizeof out->tension_offset);
  out->row[0] = o->row;
}

long step_size(void) { return sizeof(step); }
long step_outcome(void) { return offsetof(step, out); }

/* A controller at rest under its first commands, on a course that stays where it is. */
void step_open(step *o, const settings *set, const course *way, linearise *modal, const double *pressures, const double *tensions,
               int ahead) {
  memset(o, 0, sizeof *o);
  o->set = *set;
  o->way = *way;
  o->modal = modal;
  o->ahead = o->declared = ahead;
  o->measured = o->out.noise[0] = set->declared_noise;
  for (int k = 0; k < KEPT; k++) o->kept[k].row = -1;
  o->sents = 1;
  o->sent[0].at = -INFINITY;
  for (int j = 0; j < NA; j++) { o->sent[0].command.pressure[j] = pressures[j]; o->sent[0].command.tension[j] = tensions[j]; }
  o->acts[0].now = o->acts[0].told = o->sent[0].command;
  for (int j = 0; j < NA; j++) {
    o->acts[0].entered[j] = pressures[j];
    o->acts[0].entered[NA + j] = tensions[j];
    o->acts[0].extra[j] = set->first_extra[j];
    o->acts[0].share[0][j] = set->filling;
    o->acts[0].share[1][j] = set->exhausting;
    o->acts[0].covariance[0][0][j] = o->acts[0].covariance[1][1][j] = set->lag_variance;
    o->acts[0].path[j] = pressures[j];
    o->acts[0].off[j] = NAN;
    o->acts[0].misfit[j] = 2 * set->lag_misfit[j] * set->lag_misfit[j];
    o->acts[0].covariance[2][2][j] = set->lag_offset[j] * set->lag_offset[j];
  }
  set_factor(o, &o->acts[0], set->factor_first, set->factor_std * set->factor_std);
  filter *f = &o->filters[0];
  for (int i = 0; i < NS; i++) {
    double spread = i < NX ? 1e-2 : i < STRENGTH ? 0.5 : i < FRICTION ? set->strength_std : i < HYSTERESIS ? set->friction_std
                    : i < BIAS ? set->hysteresis_std : i < NS - 3 ? set->bias_std : 1e-3;
    f->covariance[i][i] = spread * spread;
    f->mean[i] = i < FRICTION || i >= BIAS ? 0 : i < HYSTERESIS ? set->friction : set->hysteresis;
  }
}

/* No pressure monitor is believed from now on; readings must not be given any more. */
void step_distrust_monitors(step *o) {
  for (int j = 0; j < NA; j++) o->acts[0].noise[j] = o->acts[1].noise[j] = INFINITY;
  o->ready = 0;
}

/* Does what the next sample is not needed for, should it come a period after the last one. Returns 0, or 1 where the network cannot be
   linearised about the reference. */
int step_prepare(step *o) { return prepare(o, o->row + (o->samples > 0)); }

/* From a sample (time in s, points in m with NaN where lost, measured pressures in Pa and tensions in N or null) to the commands in
   o->out; `deadline` in s after which the last plan goes on. Returns as step_prepare. */
int step_feedback(step *o, double time, double deadline, const double *points, const double *pressures, const double *tensions) {
  struct timespec began;
  timespec_get(&began, TIME_UTC);
  if (!o->samples) o->zero = time;
  long row = lrint((time - o->zero) / o->set.period);
  if (row < o->row) row = o->row;
  if ((!o->ready || o->ready_row != row) && prepare(o, row)) return 1;
  double passed = (row - o->row) * o->set.period, area[NA], turning[NA], motion[NX], there[NX], forces[2][NA];
  o->now = !o->now;
  o->row = row;
  o->ready = 0;
  filter *f = &o->filters[o->now];
  actuators *a = &o->acts[o->now];
  take_gauges(o, a, pressures, tensions, passed, acting(o, o->row));
  affect(o, a);
  correct(o, f, &o->to_do, points);
  o->corrected = 1;
  devices acted = a->now;
  memcpy(motion, f->mean, sizeof motion);
  memcpy(turning, f->turning, sizeof turning);
  for (int j = 0; j < NA; j++) area[j] = o->set.area * (1 + f->mean[STRENGTH + j]);
  for (int k = 0; k < o->ahead; k++) {
    devices before = acted;
    advance(o, a, &acted, acting(o, row + k), area, forces);
    for (int j = 0; j < NA; j++) {
      turning[j] = dahl_step(turning[j], o->set.area * (acted.pressure[j] - before.pressure[j]), o->set.width);
      double more = a->extra[j] + f->mean[FORCE + j] - f->at->forces[j] - f->mean[FRICTION + j] * o->directions[k][j] * loaded(o, acted.tension[j])
                  - f->mean[HYSTERESIS + j] * turning[j];
      forces[0][j] += more;
      forces[1][j] += more;
    }
    for (int i = 0; i < NX; i++) {
      double sum = 0;
      for (int j = 0; j < NX; j++) sum += f->at->A[i][j] * motion[j];
      for (int j = 0; j < NA; j++) sum += f->at->by_start[i][j] * forces[0][j] + f->at->by_end[i][j] * forces[1][j];
      there[i] = sum;
    }
    memcpy(motion, there, sizeof motion);
  }
  for (int i = 0; i < NX; i++) {
    there[i] = i < NQ ? o->shift[i] : 0;
    for (int j = 0; j < NQ; j++) there[i] += o->turn[i % NQ][j] * motion[i / NQ * NQ + j];
  }
  if (o->beyond.at != f->at) memcpy(motion, there, sizeof motion);
  decide(o, motion, &acted, area, turning, &began, deadline);
  devices command;
  memcpy(command.pressure, o->out.pressures, sizeof command.pressure);
  memcpy(command.tension, o->out.tensions, sizeof command.tension);
  send(o, time + o->ahead * o->set.period, &command, time - MOST_LATE * o->set.period);
  tell(o, a);
  int count = fabs(lateness(o, a)) > o->set.whole * o->set.period ? (int)rint(lateness(o, a) / o->set.period) : 0;
  int before = o->ahead, now = o->ahead + count;
  if (count) a->late = a->weight = a->spread = 0;
  o->ahead = now < 1 ? 1 : now > o->declared + MOST_LATE ? o->declared + MOST_LATE : now;
  if (o->ahead != before) {
    o->ready = 0;
    for (int k = 0; k < o->sents; k++) o->sent[k].at += (o->ahead - before) * o->set.period;
  }
  memcpy(o->seen[o->samples++ % NOISE_WINDOW], points, sizeof o->seen[0]);
  o->out.ahead[0] = o->ahead;
  o->out.seconds[0] = since(&began);
  return 0;
}

/* Basis (NCO, NSHAPE), values, damping, drive, points and gain of the operating point of the estimate, then A, start and end. */
void step_point(const step *o, double **to) {
  const operating *at = o->filters[o->now].at;
  const void *from[] = {at->basis, at->values, at->damping, at->drive, at->observe, at->gain, at->A, at->start, at->end};
  const size_t sizes[] = {sizeof at->basis, sizeof at->values, sizeof at->damping, sizeof at->drive, sizeof at->observe, sizeof at->gain,
                          sizeof at->A, sizeof at->start, sizeof at->end};
  for (int k = 0; k < 9; k++) memcpy(to[k], from[k], sizes[k]);
}
