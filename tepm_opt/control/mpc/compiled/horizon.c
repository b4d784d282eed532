/* What forces over the coming stages cost: the arm about the reference, the cost beyond the last stage, and the program's Hessian. */

/* One step of the Riccati recursion on. */
static void step_back(horizon *h, const settings *s) {
  double F[NZ][NZ] = {{0}}, G[NZ][NZ], by[NZ][NA] = {{0}}, G_by[NZ][NA], inner[NA][NA], gain[NA][NZ], (*V)[NZ] = h->value;
  for (int i = 0; i < NX; i++) {
    memcpy(F[i], h->A[i], sizeof h->A[i]);
    for (int j = 0; j < NA; j++) { F[i][NX + j] = h->start[i][j] + h->end[i][j]; by[i][j] = h->end[i][j]; }
  }
  for (int j = 0; j < NA; j++) F[NX + j][NX + j] = by[NX + j][j] = 1;
  TIMES(NZ, NZ, NZ, V, F, G, 0);
  TIMES(NZ, NZ, NA, V, by, G_by, 0);
  TIMES_BACK(NA, NZ, NA, by, G_by, inner, 0);
  TIMES_BACK(NA, NZ, NZ, by, G, gain, 0);
  for (int j = 0; j < NA; j++) inner[j][j] += 1 / (s->change * s->change);
  upper(NA, inner[0], NA, 0);
  backed(NA, inner[0], NA, NZ, gain[0], NZ, 1); /* of the value, the square of this goes off */
  TIMES_BACK(NZ, NZ, NZ, F, G, V, 0);
  for (int k = 0; k < NA; k++)
    for (int i = 0; i < NZ; i++) { double t = gain[k][i]; for (int j = 0; j < NZ; j++) V[i][j] -= t * gain[k][j]; }
  for (int i = 0; i < NQ; i++) for (int j = 0; j < NQ; j++) V[i][j] += h->Q[i][j];
  for (int j = 0; j < NA; j++) V[NX + j][NX + j] += 1 / (s->force * s->force);
  for (int i = 0; i < NZ; i++) for (int j = 0; j < i; j++) V[i][j] = V[j][i] = (V[i][j] + V[j][i]) / 2;
}

/* The cost beyond the last stage about another operating point; at first where the recursion ends. */
static void value(step *o, horizon *h, const operating *before) {
  double turn[NQ][NQ], shift[NQ], T[NZ][NZ], (*V)[NZ] = h->value;
  if (!before) {
    memset(V, 0, sizeof h->value);
    for (int round = 0; round < 20000; round++) {
      double was = 0, moved = 0;
      memcpy(T, V, sizeof T);
      step_back(h, &o->set);
      for (int i = 0; i < NZ; i++) { was = most(was, V[i][i]); moved = most(moved, fabs(V[i][i] - T[i][i]) / most(V[i][i], 1e-300)); }
      if (moved < 1e-14) break;
    }
  } else if (before != h->at) {
    seen_from(o, o->beyond.at, before, turn, shift);
    operating *at = &o->kept[h->at->row % KEPT];
    memcpy(at->turn, turn, sizeof turn);
    memcpy(at->shift, shift, sizeof shift);
    at->before = before->row;
    memcpy(T, V, sizeof T);
    for (int part = 0; part < NX; part += NQ) TIMES(NQ, NQ, NZ, turn, V + part, T + part, 0);
    for (int i = 0; i < NZ; i++)
      for (int j = 0; j < NZ; j++) {
        double sum = 0;
        if (j >= NX) sum = T[i][j];
        else for (int k = 0; k < NQ; k++) sum += T[i][j / NQ * NQ + k] * turn[j % NQ][k];
        V[i][j] = sum;
      }
  }
  step_back(h, &o->set);
}

/* A new present: stage 0 is at a period of the reference. */
static void look_from(step *o, const operating *at, long period) {
  horizon *h = &o->beyond;
  const settings *s = &o->set;
  const operating *before = h->at;
  const course *c = &o->way;
  double duration = PERIODS * s->period, first[NX][NQ], last[NX][NQ], T[NX][NX], path[PREVIEW + 3][NQ], drift[PREVIEW + 1][NQ];
  h->at = at;
  for (int i = 0; i < NX; i++)
    for (int j = 0; j < NQ; j++) { T[i][j] = at->start[i][j] + at->end[i][j] / 2; T[i][NQ + j] = at->end[i][j] / 2; }
  double both[NX][NX];
  TIMES(NX, NX, NX, at->A, T, both, 0);
  for (int i = 0; i < NX; i++)
    for (int j = 0; j < NQ; j++) {
      first[i][j] = both[i][j] + at->start[i][j] / 2;
      last[i][j] = both[i][NQ + j] + at->start[i][j] / 2 + at->end[i][j];
    }
  TIMES(NX, NX, NX, at->A, at->A, h->A, 0);
  TIMES(NX, NQ, NA, first, at->drive, h->start, 0);
  TIMES(NX, NQ, NA, last, at->drive, h->end, 0);

  double weights[NCO][NQ], there[PREVIEW + 3][NCO];
  long rows[PREVIEW + 3];
  for (int i = 0; i < NCO; i++) for (int j = 0; j < NQ; j++) weights[i][j] = o->way.masses[i] * at->basis[i][j];
  for (int k = 0; k < PREVIEW + 3; k++) {
    rows[k] = at_row(o, period + PERIODS * (k - 1));
    const double *levels = c->levels + rows[k] * NLEVELS + NLEVELS - NCO;
    for (int i = 0; i < NCO; i++) there[k][i] = levels[i] - at->levels[i];
  }
  TIMES(PREVIEW + 3, NCO, NQ, there, weights, path, 0);
  h->speed = 0;
  for (int k = 0; k < STAGES; k++) {
    double squares = 0;
    for (int i = 0; i < 3; i++) { double way = c->tips[rows[k + 2] * 3 + i] - c->tips[rows[k + 1] * 3 + i]; squares += way * way; }
    h->speed += sqrt(squares) / STAGES / duration;
  }
  for (int k = 0; k <= PREVIEW; k++) {
    double rate[NQ];
    for (int i = 0; i < NQ; i++) {
      rate[i] = (path[k + 2][i] - path[k][i]) / (2 * duration);
      drift[k][i] = -(path[k + 2][i] - 2 * path[k + 1][i] + path[k][i]) / (duration * duration);
      if (!k) h->rate[i] = rate[i];
    }
    for (int i = 0; i < NQ; i++) for (int j = 0; j < NQ; j++) drift[k][i] -= at->damping[i][j] * rate[j];
    memcpy(h->forces[k], c->forces + rows[k + 1] * NA, sizeof h->forces[k]);
  }
  for (int k = 0; k < STAGES; k++)
    for (int i = 0; i < NX; i++) {
      double sum = 0;
      for (int j = 0; j < NQ; j++) sum += first[i][j] * drift[k][j] + last[i][j] * drift[k + 1][j];
      h->pushed[k][i] = sum;
    }

  double answer[NY][NA], square[NA][NA], hold[NA][NY], by[NA][NQ], tip[3][3], back[3][NA];
  for (int p = 0; p < NY; p++)
    for (int j = 0; j < NA; j++) {
      answer[p][j] = 0;
      for (int i = 0; i < NQ; i++) answer[p][j] += at->observe[p][i] * (at->drive[i][j] / at->values[i]);
      hold[j][p] = answer[p][j];
    }
  TIMES_BACK(NA, NY, NA, answer, answer, square, 0);
  for (int j = 0; j < NA; j++) square[j][j] += s->ridge * s->ridge;
  upper(NA, square[0], NA, 0);
  backed(NA, square[0], NA, NY, hold[0], NY, 0);
  TIMES(NA, NY, NQ, hold, at->observe, by, 0);
  for (int k = 0; k < PREVIEW; k++)
    for (int j = 0; j < NA; j++) {
      double sum = 0;
      for (int i = 0; i < NQ; i++) sum -= drift[k + 1][i] / at->values[i] * by[j][i];
      h->dynamic[k][j] = sum;
    }
  const double (*gain)[NA] = at->gain + NY - 3;
  for (int i = 0; i < 3; i++) {
    memcpy(back[i], gain[i], sizeof back[i]);
    for (int j = 0; j < 3; j++) {
      tip[i][j] = i == j ? s->nothing * s->nothing : 0;
      for (int k = 0; k < NA; k++) tip[i][j] += gain[i][k] * gain[j][k];
    }
  }
  upper(3, tip[0], 3, 0);
  backed(3, tip[0], 3, NA, back[0], NA, 0);
  for (int j = 0; j < NA; j++) for (int i = 0; i < 3; i++) h->undo[j][i] = -back[i][j];

  memset(h->Q, 0, sizeof h->Q);
  for (int p = 0; p < NY; p++) {
    double weight = p < NY - 3 ? s->shape : is_blind(s, &o->filters[!o->now]) ? s->blind_tip : s->tip;
    for (int i = 0; i < NQ; i++) for (int j = 0; j < NQ; j++) h->Q[i][j] += at->observe[p][i] * at->observe[p][j] / (weight * weight);
  }
  value(o, h, before);
}

/* H by deviations of the forces at stages 1 …, its upper half: what a force does depends only on how long ago it was. */
static void condense(step *o) {
  const horizon *h = &o->beyond;
  const settings *s = &o->set;
  double later[STAGES][NA][NX], A[NX][NX], row[NA][NX], seen[NQ][NV], ends[NX][NV]; /* rows are forces: of `later`, after so many stages */
  double (*H)[NV] = o->hessian, change = 1 / (s->change * s->change), force = 1 / (s->force * s->force);
  for (int i = 0; i < NX; i++) {
    for (int j = 0; j < NX; j++) A[j][i] = h->A[i][j];
    for (int j = 0; j < NA; j++) { later[0][j][i] = h->end[i][j]; later[1][j][i] = h->start[i][j]; }
  }
  for (int k = 1; k < STAGES; k++) TIMES(NA, NX, NX, later[k - 1], A, later[k], k == 1);
  for (int k = 0; k < STAGES; k++) { /* the force of stage j acts for STAGES - 1 - j stages */
    TIMES(NA, NX, NX, later[k], h->value, row, 0);
    for (int j = 0; j < NA; j++) for (int i = 0; i < NX; i++) ends[i][(STAGES - 1 - k) * NA + j] = row[j][i];
    if (k == STAGES - 1) break;
    TIMES(NA, NQ, NQ, later[k], h->Q, row, 0);
    for (int j = 0; j < NA; j++) for (int i = 0; i < NQ; i++) seen[i][(STAGES - 2 - k) * NA + j] = row[j][i];
  }
  for (int i = 0; i < NX; i++) /* the last force is in the cost beyond */
    for (int j = 0; j < NA; j++) ends[i][NV - NA + j] += h->value[i][NX + j];
  for (int i = STAGES - 1; i >= 0; i--) { /* sums over the stages, each row of blocks from the one below it */
    int first = i * NA, left = NV - first;
    for (int r = 0; r < NA; r++) {
      double *to = H[first + r] + first;
      if (left > NA) memcpy(to, H[first + NA + r] + first + NA, (left - NA) * sizeof(double));
      for (int j = left - NA; j < left; j++) to[j] = 0;
    }
    if (left > NA) times(NA, NQ, left - NA, later[STAGES - 2 - i][0], NX, 1, seen[0] + first, NV, H[first] + first, NV, 1);
  }
  for (int i = 0; i < NV; i += NA) times(NA, NX, NV - i, later[STAGES - 1 - i / NA][0], NX, 1, ends[0] + i, NV, H[i] + i, NV, 1);
  for (int r = 0; r < NA; r++)
    for (int k = 0; k < NA; k++) {
      double sum = h->value[NX + r][NX + k];
      for (int i = 0; i < NX; i++) sum += h->value[NX + r][i] * later[0][k][i];
      H[NV - NA + r][NV - NA + k] += sum;
    }
  for (int i = 0; i < NV; i++) {
    H[i][i] += i < NV - NA ? 2 * change + force : change;
    if (i < NV - NA) H[i][i + NA] -= change;
  }
}

/* Gradient by deviations v of the forces, (STAGES, NA), which are `begin` at stage 0, with the arm at `state` and the aim `rest`. */
static void gradient(const step *o, const double *state, const double *begin, double v[STAGES][NA], const double *rest_force,
                     const double *rest, double g[STAGES][NA]) {
  const horizon *h = &o->beyond;
  const settings *s = &o->set;
  double x[STAGES + 1][NX], back[NX], was[NX], left[NZ], change = 1 / (s->change * s->change), force = 1 / (s->force * s->force);
  double turned_A[NX][NX];
  for (int i = 0; i < NX; i++) for (int j = 0; j < NX; j++) turned_A[j][i] = h->A[i][j]; /* sums over rows go side by side */
  memcpy(x[0], state, sizeof x[0]);
  for (int k = 0; k < STAGES; k++) {
    const double *before = k ? v[k - 1] : begin;
    for (int i = 0; i < NX; i++) {
      double sum = h->pushed[k][i];
      for (int j = 0; j < NA; j++) sum += h->start[i][j] * before[j] + h->end[i][j] * v[k][j];
      x[k + 1][i] = sum;
    }
    TIMES(1, NX, NX, x + k, turned_A, x + k + 1, 1);
  }
  for (int i = 0; i < NX; i++) left[i] = x[STAGES][i] - (i < NQ ? rest[i] : 0);
  for (int j = 0; j < NA; j++) left[NX + j] = v[STAGES - 1][j] - rest_force[j];
  for (int k = 0; k < STAGES; k++)
    for (int j = 0; j < NA; j++) {
      double at = v[k][j];
      g[k][j] = change * (at - (k ? v[k - 1][j] : begin[j]));
      if (k < STAGES - 1) g[k][j] += change * (at - v[k + 1][j]) + force * (at - rest_force[j]);
    }
  for (int i = 0; i < NZ; i++) {
    double sum = 0;
    for (int j = 0; j < NZ; j++) sum += h->value[i][j] * left[j];
    if (i < NX) back[i] = sum;
    else g[STAGES - 1][i - NX] += sum;
  }
  for (int k = STAGES - 1; k >= 0; k--) {
    for (int i = 0; i < NX; i++)
      for (int j = 0; j < NA; j++) {
        g[k][j] += h->end[i][j] * back[i];
        if (k) g[k - 1][j] += h->start[i][j] * back[i];
      }
    if (!k) break;
    memcpy(was, back, sizeof was);
    memset(back, 0, sizeof back);
    for (int j = 0; j < NQ; j++) { double e = x[k][j] - rest[j]; for (int i = 0; i < NQ; i++) back[i] += h->Q[j][i] * e; }
    times(1, NX, NX, was, NX, 1, h->A[0], NX, back, NX, 1);
  }
}
