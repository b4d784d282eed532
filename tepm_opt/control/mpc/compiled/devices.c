/* Regulators and motors: their lags, gauges and commands on their way. */

static int is_noisy(const step *o, const actuators *a, int j) { return a->noise[j] > o->set.monitor_noisy[j]; }

static int is_believed(const step *o, const actuators *a, int j) { return !isnan(a->off[j]) && !is_noisy(o, a, j); }

/* Whether the factor tells more of a regulator than a monitor: none is believed, or it shows that valves are quick. */
static int is_unmonitored(const step *o, const actuators *a, int j) {
  return !is_believed(o, a, j) || least(a->share[0][j], a->share[1][j]) > o->set.as_commanded;
}

/* Lets regulators without monitors go by a factor on their declared lags. */
static void set_factor(const step *o, actuators *a, double factor, double variance) {
  const settings *s = &o->set;
  a->factor = factor;
  a->factor_variance = variance;
  double doubt = s->factor_caution * sqrt(variance);
  a->nearest_factor = within(1, factor - doubt, factor + doubt);
  double factors[2] = {factor, most(factor - doubt, s->factor_least)};
  for (int k = 0; k < 2; k++)
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
    double missing = command->pressure[j] - a->path[j], share = a->share[!(missing > 0)][j], before = a->rise[j];
    a->path[j] = command->pressure[j] - missing * (1 - share);
    a->rise[j] = share * missing;
    a->turned[j] = fabs(a->rise[j] - before);
  }
}

/* What readings miss that are a period early or late, with a command in force. */
static double timing_error(const actuators *a, int j, const devices *command) {
  double missing = command->pressure[j] - a->path[j];
  return most(a->turned[j], fabs(a->share[!(missing > 0)][j] * missing - a->rise[j]));
}

/* What a reading says of a regulator's lags, and with them of its pressure by commands alone. */
static void learn(const step *o, actuators *a, int j, double measured, double passed, double timing) {
  const settings *s = &o->set;
  double by[3] = {a->slope[0][j], a->slope[1][j], 1}, seen[3] = {0}, all = s->lag_noise[j] * s->lag_noise[j];
  double missed = measured - a->path[j] - a->offset_path[j];
  double beside = most(fabs(missed) - timing, 0), first = fabs(missed - a->off[j]); /* NaN before the second reading */
  double apart = most(first - timing, 0) / s->moving_range;
  a->misfit[j] += (1 - exp(-passed / s->lag_forgotten)) * (beside * beside - a->misfit[j]);
  if (isfinite(first)) a->noise[j] += (1 - exp(-passed / s->lag_forgotten)) * (apart - a->noise[j]);
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

/* Part of a difference that exceeds a possible error. */
static double beyond(double off, double error) { return copysign(most(fabs(off) - error, 0), off); }

static void take_gauges(const step *o, actuators *a, const double *pressures, const double *tensions, double passed, const devices *command) {
  double share = 1 - exp(-passed / o->set.lasting), by = 0, squares = 0, spread = 0;
  for (int j = 0; j < NA; j++) {
    double timing = timing_error(a, j, command);
    if (pressures && isfinite(pressures[j])) learn(o, a, j, pressures[j], passed, timing);
    double pressure = beyond(missed(pressures, j, a->told.pressure[j] + a->offset.pressure[j]), timing);
    double read = missed(tensions, j, a->told.tension[j] + a->offset.tension[j]);
    double tension = fmin(fmax(read, -o->set.farthest), o->set.farthest);
    a->offset.pressure[j] += share * pressure;
    a->offset.tension[j] += read - tension + share * tension;
    if (tensions && isfinite(tensions[j])) { by += tension * a->rate[j]; squares += a->rate[j] * a->rate[j]; spread += tension * tension; }
    double off = beyond(missed(pressures, j, a->now.pressure[j] + a->offset.pressure[j]), timing);
    if (!is_unmonitored(o, a, j)) a->now.pressure[j] = most(a->now.pressure[j] + o->set.belief * off, 0);
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
