/* DiscreteModalModel points: the modal model of a row of the reference, in discrete time. */

/* exp, and the integrals of it that make up start and end, over a period: a series over a part of the period that is short for the
   fastest mode, doubled up. */
static void discretise(operating *o, double period) {
  double size = 0, part = period, P[NX][NX] = {{0}}, T[NX][NX] = {{0}}, N[NX][NX], once[NX][NQ];
  int doublings = 0;
  for (int i = 0; i < NQ; i++) {
    double row = sqrt(fabs(o->values[i]));
    for (int j = 0; j < NQ; j++) row += fabs(o->damping[i][j]);
    size = most(size, row);
  }
  for (; size * part > 1; part /= 2) doublings++;
  for (int i = 0; i < NX; i++) P[i][i] = T[i][i] = 0.5;
  for (int k = 3; k < 20; k++) { /* sum of (part a)^k / (k + 2)! */
    double by = part / k;
    for (int i = 0; i < NQ; i++) {
      double *low = N[i], *high = N[NQ + i];
      for (int j = 0; j < NX; j++) { low[j] = T[NQ + i][j]; high[j] = -o->values[i] * T[i][j]; }
      for (int p = 0; p < NQ; p++) { double s = o->damping[i][p]; for (int j = 0; j < NX; j++) high[j] -= s * T[NQ + p][j]; }
    }
    for (int i = 0; i < NX; i++) for (int j = 0; j < NX; j++) P[i][j] += T[i][j] = by * N[i][j];
  }
  for (int round = 0; round < 2; round++) { /* from sum (part a)^k / (k + 2)! to (k + 1)! and to k! */
    for (int i = 0; i < NQ; i++) {
      for (int j = 0; j < NX; j++) { N[i][j] = part * P[NQ + i][j]; N[NQ + i][j] = -part * o->values[i] * P[i][j]; }
      for (int p = 0; p < NQ; p++) { double s = part * o->damping[i][p]; for (int j = 0; j < NX; j++) N[NQ + i][j] -= s * P[NQ + p][j]; }
    }
    for (int i = 0; i < NX; i++) N[i][i] += 1;
    for (int i = 0; i < NX; i++)
      for (int j = 0; j < NQ; j++) {
        if (!round) { o->end[i][j] = part * P[i][NQ + j]; once[i][j] = part * N[i][NQ + j]; }
      }
    memcpy(P, N, sizeof P);
  }
  memcpy(o->A, P, sizeof P);
  for (int i = 0; i < NX; i++) for (int j = 0; j < NQ; j++) o->start[i][j] = once[i][j] - o->end[i][j];
  for (; doublings; doublings--) {
    double first[NX][NQ], last[NX][NQ];
    for (int i = 0; i < NX; i++)
      for (int j = 0; j < NQ; j++) { N[i][j] = o->start[i][j] + o->end[i][j] / 2; N[i][NQ + j] = o->end[i][j] / 2; }
    TIMES(NX, NX, NX, o->A, N, T, 0);
    for (int i = 0; i < NX; i++)
      for (int j = 0; j < NQ; j++) {
        first[i][j] = T[i][j] + o->start[i][j] / 2;
        last[i][j] = T[i][NQ + j] + o->start[i][j] / 2 + o->end[i][j];
      }
    TIMES(NX, NX, NX, o->A, o->A, P, 0);
    memcpy(o->A, P, sizeof P);
    memcpy(o->start, first, sizeof first);
    memcpy(o->end, last, sizeof last);
  }
}

/* The operating point of a period, made from the newest one where it is not kept; null where it cannot be. */
static operating *point(step *o, long period) {
  long row = at_row(o, period);
  operating *p = &o->kept[row % KEPT];
  if (p->row == row) return p;
  const course *c = &o->way;
  int first = !o->newest;
  if (first) { memcpy(p->basis, c->basis, sizeof p->basis); memcpy(p->values, c->values, sizeof p->values); }
  else if (p != o->newest) memcpy(p->basis, o->newest->basis, sizeof p->basis);
  p->row = p->before = -1;
  p->levels = c->levels + row * NLEVELS;
  if (o->modal(p->levels, c->inputs + row * 2 * NA, c->mapped[row], c->loads + row * NY, c->theta, c->masses, c->by, first ? 0 : SWEEPS,
               o->set.near, p->basis[0], p->values, p->damping[0], p->drive[0], p->observe[0], p->gain[0])) return 0;
  for (int i = 0; i < NQ * NQ; i++) p->damping[0][i] *= o->set.damping;
  p->row = row;
  p->levels += NLEVELS - NCO;
  p->forces = c->forces + row * NA;
  p->points = c->points + row * NY;
  discretise(p, o->set.period);
  TIMES(NX, NQ, NA, p->start, p->drive, p->by_start, 0);
  TIMES(NX, NQ, NA, p->end, p->drive, p->by_end, 0);
  return o->newest = p;
}

/* Modal coordinates q about `from` are turn q + shift about `to`. */
static void seen_from(const step *o, const operating *to, const operating *from, double turn[NQ][NQ], double *shift) {
  memset(turn, 0, sizeof(double) * NQ * NQ);
  if (shift) memset(shift, 0, sizeof(double) * NQ);
  for (int c = 0; c < NCO; c++) {
    double off = from->levels[c] - to->levels[c];
    for (int i = 0; i < NQ; i++) {
      double weight = o->way.masses[c] * to->basis[c][i];
      for (int j = 0; j < NQ; j++) turn[i][j] += weight * from->basis[c][j];
      if (shift) shift[i] += weight * off;
    }
  }
}
