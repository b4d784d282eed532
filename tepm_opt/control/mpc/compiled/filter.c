/* The Kalman filter, and the factor of the regulators' lags beside it. */

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
  double longest = s->factor_most;
  for (int j = 0; j < NA; j++) if (is_believed(o, a, j) && is_unmonitored(o, a, j)) longest = s->factor_quick;
  set_factor(o, a, within(before + moved, s->factor_least, longest), gain);
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
