/* Regulators, motors and the Kalman filter. */

static int is_noisy(const step *o, const actuators *a, int j) { return a->noise[j] > o->set.monitor_noisy[j]; }

static int is_unmonitored(const step *o, const actuators *a, int j) { return isnan(a->off[j]) || is_noisy(o, a, j); }

/* Lets regulators without monitors go by a factor on their declared lags. */
static void set_factor(const step *o, actuators *a, double factor, double variance) {
  const settings *s = &o->set;
  a->factor = factor;
  a->factor_variance = variance;
  double doubt = s->factor_caution * sqrt(variance);
  a->lead_factor = within(1, factor - doubt, factor + doubt);
  double factors[3] = {factor, a->lead_factor, most(factor - doubt, s->factor_least)};
  for (int k = 0; k < 3; k++)
    for (int i = 0; i < 2; i++) a->common[k][i] = least(1 - pow(1 - (i ? s->exhausting : s->filling), 1 / factors[k]), 1 - s->at_once);
}

/* Share of what is missing by which a pressure nears its command in a period: as learned where readings fit, else as declared; with the
   factor where no monitor is believed. */
static double share_of(const step *o, const actuators *a, int j, int exhausts) {
  const settings *s = &o->set;
  if (is_unmonitored(o, a, j)) return a->common[0][exhausts];
  double most = s->lag_misfit[j] * s->lag_misfit[j];
  int fits = a->misfit[j] < most && a->offset_path[j] * a->offset_path[j] < 36 * most;
  return fits ? a->share[exhausts][j] : exhausts ? s->exhausting : s->filling;
}

static double lagged(const step *o, const actuators *a, int j, double pressure, double command, int periods) {
  double missing = command - pressure, left = 1 - share_of(o, a, j, !(missing > 0));
  return command - missing * (periods == 1 ? left : left * left);
}

/* Devices a control period on under a command, with lags as they are known; F_a at its start and end with these areas. */
static void advance(const step *o, const actuators *known, devices *d, const devices *command, const double *area, double forces[2][NA]) {
  for (int j = 0; j < NA; j++) {
    if (forces) forces[0][j] = area[j] * d->pressure[j] - d->tension[j];
    d->pressure[j] = lagged(o, known, j, d->pressure[j], command->pressure[j], 1);
    d->tension[j] += within(command->tension[j] - d->tension[j], -o->set.pull, o->set.pull);
    if (forces) forces[1][j] = area[j] * d->pressure[j] - d->tension[j];
  }
}

/* Slopes of the pressures by the factor of the lags, a period on from these pressures. */
static void slope_by_factor(const step *o, actuators *a, const devices *command) {
  for (int j = 0; j < NA; j++) {
    double missing = command->pressure[j] - a->now.pressure[j], left = 1 - share_of(o, a, j, !(missing > 0));
    a->by_factor[j] = left * a->by_factor[j] + (is_unmonitored(o, a, j) ? left * log(left) / a->factor : 0) * missing;
  }
}

/* Slopes of the pressures by commands alone, by the logarithms of the shares, a period on. */
static void slope(actuators *a, const devices *command) {
  for (int j = 0; j < NA; j++) {
    double missing = command->pressure[j] - a->path[j];
    int exhausts = !(missing > 0);
    double share = a->share[exhausts][j];
    for (int k = 0; k < 2; k++) a->slope[k][j] = (1 - share) * a->slope[k][j] + (k == exhausts ? share * missing : 0);
  }
}

/* What commands alone make of pressures in a period, with the lags as learned. */
static void follow(actuators *a, const devices *command) {
  for (int j = 0; j < NA; j++) {
    double missing = command->pressure[j] - a->path[j];
    a->path[j] = command->pressure[j] - missing * (1 - a->share[!(missing > 0)][j]);
  }
}

/* What a reading says of a regulator's lags, and with them of its pressure by commands alone. */
static void learn(const step *o, actuators *a, int j, double measured, double passed) {
  const settings *s = &o->set;
  double by[3] = {a->slope[0][j], a->slope[1][j], 1}, seen[3] = {0}, all = s->lag_noise[j] * s->lag_noise[j];
  double missed = measured - a->path[j] - a->offset_path[j];
  a->misfit[j] += (1 - exp(-passed / s->lag_forgotten)) * (missed * missed - a->misfit[j]);
  double apart = fabs(missed - a->off[j]) / s->moving_range; /* NaN before the second reading */
  if (isfinite(apart)) a->noise[j] += (1 - exp(-passed / s->lag_forgotten)) * (apart - a->noise[j]);
  a->off[j] = missed;
  for (int i = 0; i < 2; i++) a->covariance[i][i][j] += passed * s->lag_drift * s->lag_drift;
  for (int i = 0; i < 3; i++) for (int k = 0; k < 3; k++) seen[i] += a->covariance[i][k][j] * by[k];
  for (int i = 0; i < 3; i++) all += by[i] * seen[i];
  for (int i = 0; i < 3; i++) for (int k = 0; k < 3; k++) a->covariance[i][k][j] -= seen[i] * seen[k] / all;
  a->offset_path[j] += seen[2] / all * missed;
  for (int k = 0; k < 2; k++) {
    double moved = within(seen[k] / all * missed, -s->lag_jump, s->lag_jump), first = k ? s->exhausting : s->filling;
    a->share[k][j] = within(a->share[k][j] * exp(moved), s->lag_least * first, 1 - s->at_once);
    a->path[j] += by[k] * moved;
  }
}

/* The model's effects on inputs, a period on to the present pressures and tensions. */
static void affect(const step *o, actuators *a) {
#if EFFECTS
  double now[2 * NA], rate[2 * NA], effective[2 * NA], memory[MEMORY + 1];
  const double *arg[] = {now, rate, a->memory, &o->set.period, o->way.free};
  double *res[] = {effective, memory};
  for (int k = 0; k < 2 * NA; k++) {
    now[k] = k < NA ? a->now.pressure[k] : a->now.tension[k - NA];
    rate[k] = (now[k] - a->entered[k]) / o->set.period;
  }
  input_motion(arg, res);
  memcpy(a->entered, now, sizeof now);
  memcpy(a->memory, memory, MEMORY * sizeof(double));
  for (int j = 0; j < NA; j++) a->extra[j] = o->set.area * (effective[j] - now[j]) - (effective[NA + j] - now[NA + j]);
#else
  (void)o, (void)a;
#endif
}

/* The command in force over a period; the oldest one that is known where none was yet. */
static const devices *acting(const step *o, long row) {
  double start = o->zero + row * o->set.period, middle = (start + (start + o->set.period)) / 2;
  for (int k = o->sents - 1; k > 0; k--) if (o->sent[k].at <= middle) return &o->sent[k].command;
  return &o->sent[0].command;
}

static void send(step *o, double at, const devices *command, double before) {
  if (o->sents == SENT) { memmove(o->sent, o->sent + 1, (SENT - 1) * sizeof *o->sent); o->sents--; }
  o->sent[o->sents].at = at;
  o->sent[o->sents++].command = *command;
  int gone = 0;
  while (gone < o->sents - 1 && o->sent[gone + 1].at <= before) gone++;
  memmove(o->sent, o->sent + gone, (o->sents - gone) * sizeof *o->sent);
  o->sents -= gone;
}

/* What is measured above what is expected, 0 where nothing is. */
static double missed(const double *measured, int j, double expected) {
  double off = measured ? measured[j] - expected : 0;
  return isfinite(off) ? off : 0;
}

static void take_gauges(const step *o, actuators *a, const double *pressures, const double *tensions, double passed) {
  double share = 1 - exp(-passed / o->set.lasting), by = 0, squares = 0, spread = 0;
  for (int j = 0; j < NA; j++) {
    if (pressures && isfinite(pressures[j])) learn(o, a, j, pressures[j], passed);
    double pressure = missed(pressures, j, a->told.pressure[j] + a->offset.pressure[j]);
    double read = missed(tensions, j, a->told.tension[j] + a->offset.tension[j]);
    double tension = fmin(fmax(read, -o->set.farthest), o->set.farthest);
    a->offset.pressure[j] += share * pressure;
    a->offset.tension[j] += read - tension + share * tension;
    if (tensions && isfinite(tensions[j])) { by += tension * a->rate[j]; squares += a->rate[j] * a->rate[j]; spread += tension * tension; }
    if (!is_noisy(o, a, j))
      a->now.pressure[j] = most(a->now.pressure[j] + o->set.belief * missed(pressures, j, a->now.pressure[j] + a->offset.pressure[j]), 0);
    if (fabs(a->offset.tension[j]) > o->set.farthest) continue;
    a->now.tension[j] = most(a->now.tension[j] + o->set.belief * missed(tensions, j, a->now.tension[j] + a->offset.tension[j]), 0);
  }
  if (!tensions) return;
  a->late = (1 - share) * a->late - passed * by;
  a->weight = (1 - share) * a->weight + passed * squares;
  a->spread = (1 - share) * a->spread + passed * spread;
}

static double lateness(const step *o, const actuators *a) {
  return a->weight > o->set.telling && a->late * a->late >= o->set.explained * a->weight * a->spread ? a->late / a->weight : 0;
}

static double loaded(const step *o, double tension) { return 1 - o->set.load_share + o->set.load_share * tension / o->set.middle; }

/* The filter a period on, to the operating point `then`. */
static void predict(const step *o, filter *f, double forces[2][NA], double slopes[2][NA], const double *tension, const double *rates,
                    const operating *then) {
  const operating *now = f->at;
  const settings *s = &o->set;
  double A[NX][NM] = {{0}}, B[NX][NM], T[NX][NS], push[NX], noisy[NX][NA] = {{0}}, over[NA], turn[NQ][NQ], shift[NQ], kick[NX][NA] = {{0}};
  for (int j = 0; j < NA; j++) {
    double seen = 0, before = f->direction[j];
    for (int i = 0; i < NQ; i++) seen += now->drive[i][j] * f->mean[NQ + i];
    f->deviation[j] += s->rate_share * (seen - rates[j] - f->deviation[j]);
    f->direction[j] = dahl_step(before, (rates[j] + f->deviation[j]) * s->period, s->presliding);
    over[j] = fabs(f->direction[j] - before);
    double rise = forces[1][j] - forces[0][j] + (f->begun ? tension[j] - f->tension[j] : 0);
    f->turning[j] = dahl_step(f->turning[j], rise, s->width);
    f->tension[j] = tension[j];
  }
  f->begun = 1;
  for (int i = 0; i < NX; i++) {
    push[i] = 0;
    for (int j = 0; j < NX; j++) A[i][j] = now->A[i][j];
    for (int j = 0; j < NA; j++) {
      double by = now->by_start[i][j] + now->by_end[i][j];
      A[i][FORCE + j] = by;
      A[i][STRENGTH + j] = by * ((forces[0][j] + forces[1][j]) / 2 + tension[j]);
      A[i][FRICTION + j] = -by * f->direction[j] * loaded(o, tension[j]);
      A[i][HYSTERESIS + j] = -by * f->turning[j];
      push[i] += now->by_start[i][j] * (forces[0][j] - now->forces[j]) + now->by_end[i][j] * (forces[1][j] - now->forces[j]);
    }
  }
  for (int i = 0; i < NQ; i++) for (int j = 0; j < NA; j++) noisy[NQ + i][j] = s->kick * now->drive[i][j];
  if (then->before == now->row && then != now) { memcpy(turn, then->turn, sizeof turn); memcpy(shift, then->shift, sizeof shift); }
  else seen_from(o, then, now, turn, shift);
  for (int part = 0; part < NX; part += NQ) {
    TIMES(NQ, NQ, NM, turn, A + part, B + part, 0);
    TIMES(NQ, NQ, NA, turn, noisy + part, kick + part, 0);
  }
  double mean[NX], by_factor[NX], moved[NX] = {0};
  for (int i = 0; i < NX; i++) for (int j = 0; j < NA; j++) moved[i] += now->by_start[i][j] * slopes[0][j] + now->by_end[i][j] * slopes[1][j];
  for (int i = 0; i < NX; i++) {
    mean[i] = i < NQ ? shift[i] : 0;
    by_factor[i] = 0;
    for (int j = 0; j < NQ; j++) mean[i] += turn[i % NQ][j] * push[i / NQ * NQ + j];
    for (int j = 0; j < NQ; j++) by_factor[i] += turn[i % NQ][j] * moved[i / NQ * NQ + j];
    for (int j = 0; j < NM; j++) { mean[i] += B[i][j] * f->mean[j]; by_factor[i] += B[i][j] * f->by_factor[j]; }
  }
  int blind = is_blind(s, f);
  double keep[NS], grown[NS];
  for (int i = NX; i < NS; i++) {
    keep[i] = i < STRENGTH ? (blind ? s->blind_force_keeps : s->force_keeps) : i >= BIAS && i < NS - 3 && !blind ? s->bias_keeps : 1;
    double drift = i < STRENGTH ? s->force_drift : i < FRICTION ? s->strength_drift : i < HYSTERESIS ? s->friction_drift
                   : i < BIAS ? s->hysteresis_drift : i < NS - 3 ? s->bias_drift : s->tip_bias_drift;
    if (blind && i < NS - 3) drift = i < STRENGTH ? s->blind_force_drift : i < BIAS ? 0 : s->blind_bias_drift;
    grown[i] = s->period * drift * drift + (i < STRENGTH ? s->reversal_noise * s->reversal_noise * over[i - FORCE] : 0);
    f->mean[i] *= keep[i];
    f->by_factor[i] *= keep[i];
  }
  memcpy(f->mean, mean, sizeof mean);
  memcpy(f->by_factor, by_factor, sizeof by_factor);
  TIMES(NX, NM, NS, B, f->covariance, T, 0);
  double (*P)[NS] = f->covariance;
  for (int i = 0; i < NX; i++) for (int j = NX; j < NS; j++) P[i][j] = P[j][i] = T[i][j] * keep[j];
  for (int i = 0; i < NX; i++)
    for (int j = 0; j <= i; j++) {
      double sum = 0;
      for (int k = 0; k < NM; k++) sum += T[i][k] * B[j][k];
      for (int k = 0; k < NA; k++) sum += kick[i][k] * kick[j][k];
      P[i][j] = P[j][i] = sum;
    }
  for (int i = NX; i < NS; i++) {
    for (int j = NX; j < NS; j++) P[i][j] *= keep[i] * keep[j];
    P[i][i] += grown[i];
  }
  f->at = then;
}

/* What of the correction by a sample needs none: covariances of the innovation. */
static void expect(const filter *f, correction *c) {
  const operating *at = f->at;
  double by[NQ][NY];
  for (int i = 0; i < NQ; i++) for (int k = 0; k < NY; k++) by[i][k] = at->observe[k][i];
  for (int i = 0; i < NS; i++) memcpy(c->cross[i], f->covariance[i] + BIAS, sizeof c->cross[i]);
  TIMES(NS, NQ, NY, f->covariance, by, c->cross, 1);
  memcpy(c->S, c->cross + BIAS, sizeof c->S);
  TIMES(NY, NQ, NY, at->observe, c->cross, c->S, 1);
  for (int k = 0; k < NY; k++) c->S[k][k] += f->noise * f->noise;
}

/* Mean of the filter after a sample's points. */
static void correct(step *o, filter *f, correction *c, const double *points) {
  const operating *at = f->at;
  double *off = c->off, S[NY][NY], left[NY][1];
  int count = 0, which[NY];
  o->out.refusals[0] = 0;
  for (int k = 0; k < NY; k++) {
    off[k] = points[k] - at->points[k] - f->mean[BIAS + k];
    for (int i = 0; i < NQ; i++) off[k] -= at->observe[k][i] * f->mean[i];
  }
  for (int p = 0; p < NP; p++) {
    double *e = off + 3 * p, own[3][3], v[3][1] = {{e[0]}, {e[1]}, {e[2]}}, far = 0;
    int there = isfinite(points[3 * p]) && isfinite(points[3 * p + 1]) && isfinite(points[3 * p + 2]), wrong = 0;
    if (there) {
      for (int i = 0; i < 3; i++) for (int j = 0; j < 3; j++) own[i][j] = c->S[3 * p + i][3 * p + j];
      upper(3, own[0], 3, 0);
      backed(3, own[0], 3, 1, v[0], 1, 1);
      for (int i = 0; i < 3; i++) far += v[i][0] * v[i][0];
      wrong = far > o->set.gate;
    }
    f->outlying[p] = wrong ? f->outlying[p] + 1 : 0;
    int refused = wrong && f->outlying[p] <= o->set.most_rejections;
    c->good[p] = there && !refused;
    o->out.refusals[0] += o->out.refused[p] = there && refused;
    if (c->good[p]) for (int i = 0; i < 3; i++) which[count++] = 3 * p + i;
  }
  o->out.seen[0] = count;
  o->out.nis[0] = NAN;
  if (!count) return;
  f->tip_missing = c->good[NP - 1] ? 0 : f->tip_missing + 1;
  for (int i = 0; i < count; i++) {
    for (int j = i; j < count; j++) S[i][j] = c->S[which[i]][which[j]];
    left[i][0] = off[which[i]];
  }
  upper(count, S[0], NY, 0);
  backed(count, S[0], NY, 1, left[0], 1, 0);
  o->out.nis[0] = 0;
  for (int i = 0; i < count; i++) {
    o->out.nis[0] += left[i][0] * off[which[i]];
    for (int j = 0; j < NS; j++) f->mean[j] += c->cross[j][which[i]] * left[i][0];
  }
}

/* The factor of the lags after the same sample, by the factor of the covariance of its innovation, and what goes by it. */
static void learn_factor(const step *o, filter *f, actuators *a, const correction *c, int count, const int *which, double S[NY][NY],
                         double W[NY][NS]) {
  const settings *s = &o->set;
  double seen[NY][1], off[NY][1], squares = 0, both = 0;
  for (int k = 0; k < count; k++) {
    off[k][0] = c->off[which[k]];
    seen[k][0] = f->by_factor[BIAS + which[k]];
    for (int i = 0; i < NQ; i++) seen[k][0] += f->at->observe[which[k]][i] * f->by_factor[i];
  }
  backed(count, S[0], NY, 1, seen[0], 1, 1);
  backed(count, S[0], NY, 1, off[0], 1, 1);
  for (int k = 0; k < count; k++) {
    squares += seen[k][0] * seen[k][0] / s->factor_coloured;
    both += seen[k][0] * off[k][0] / s->factor_coloured;
    for (int i = 0; i < NS; i++) f->by_factor[i] -= W[k][i] * seen[k][0];
  }
  double variance = a->factor_variance + s->period * s->factor_drift * s->factor_drift, gain = variance / (1 + variance * squares);
  double before = a->factor, moved = within(gain * both, -s->factor_move, s->factor_move);
  set_factor(o, a, within(before + moved, s->factor_least, s->factor_most), gain);
  moved = a->factor - before;
  for (int i = 0; i < NS; i++) f->mean[i] += moved * f->by_factor[i];
  for (int j = 0; j < NA; j++) {
    a->now.pressure[j] = most(a->now.pressure[j] + moved * a->by_factor[j], 0);
    a->told.pressure[j] = most(a->told.pressure[j] + moved * a->by_factor[j], 0);
  }
}

/* The covariance after the same sample, and the factor of the lags, which the commands do not need. */
static void settle(const step *o, filter *f, actuators *a, const correction *c) {
  double S[NY][NY], W[NY][NS];
  int count = 0, which[NY];
  for (int k = 0; k < NY; k++) if (c->good[k / 3]) which[count++] = k;
  for (int i = 0; i < count; i++) {
    for (int j = i; j < count; j++) S[i][j] = c->S[which[i]][which[j]];
    for (int j = 0; j < NS; j++) W[i][j] = c->cross[j][which[i]];
  }
  upper(count, S[0], NY, 0);
  backed(count, S[0], NY, NS, W[0], NS, 1);
  if (count) learn_factor(o, f, a, c, count, which, S, W);
  for (int k = 0; k < count; k++)
    for (int i = 0; i < NS; i++) { double s = W[k][i]; for (int j = 0; j < NS; j++) f->covariance[i][j] -= s * W[k][j]; }
}
