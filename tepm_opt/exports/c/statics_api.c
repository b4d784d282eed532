/* What robot.h declares of statics and gain, on the loops above. */

static const double NOTHING[NU > NEXT ? NU : NEXT];

typedef struct { work w; double last[NLEV + 1][NB], u[NU], force[NEXT]; } memory_of_statics;

size_t robot_memory(void) { return sizeof(memory_of_statics); }
void robot_rest(double x[ROBOT_SHAPE]) { memcpy(x, REST, sizeof REST); }

static void begin_statics(work *w, const double *u, const double *force) {
  w->theta = THETA;
  map_inputs(w, u, w->a);
  set_properties(w, force);
}

/* One solve from w->x, with a look at what came out. */
static int solve_from(work *w, const double *u, const double *force, double *points, double *lengths) {
  double observed[NPOINT + NLEN], info[3];
  begin_statics(w, u, force);
  int status = settle(w, TOLERANCE, MOST_ITERATIONS, info);
  look(w, observed);
  memcpy(points, observed, NPOINT * sizeof(double));
  memcpy(lengths, observed + NPOINT, NLEN * sizeof(double));
  if (status != SOLVED) return status;
  for (int k = 0; k < NLEN; k++) if (!(lengths[k] >= SHORTEST_LENGTH)) return ROBOT_COLLAPSED;
  for (int l = 1; GUIDED && l <= NLEV; l++) for (int k = 2; k < NB; k += 3) if (!(w->x[l][k] > w->x[l - 1][k])) return ROBOT_COLLAPSED;
  return SOLVED;
}

/* The branch from rest, along inputs and forces that grow from 0. */
static int follow(memory_of_statics *m, const double *u, const double *force, double *points, double *lengths) {
  work *w = &m->w;
  memcpy(w->x, REST, sizeof w->x);
  int status = solve_from(w, NOTHING, NOTHING, points, lengths);
  memcpy(m->last, w->x, sizeof w->x);
  for (double reached = 0, step = 0.1; status == SOLVED && reached < 1 && step > 1e-4;) {
    double part = reached + step < 1 ? reached + step : 1;
    for (int k = 0; k < NU; k++) m->u[k] = part * u[k];
    for (int k = 0; k < NEXT; k++) m->force[k] = part * force[k];
    memcpy(w->x, m->last, sizeof w->x);
    if (solve_from(w, m->u, m->force, points, lengths) == SOLVED) {
      memcpy(m->last, w->x, sizeof w->x);
      if (part == 1) return SOLVED;
      reached = part;
      step *= 1.5;
    } else step /= 4;
  }
  return status == SOLVED ? STALLED : status;
}

int robot_statics(void *memory, const double u[ROBOT_INPUTS], const double force[3 * ROBOT_POINTS], double x[ROBOT_SHAPE],
                  double points[3 * ROBOT_POINTS], double lengths[ROBOT_ACTUATORS]) {
  memory_of_statics *m = memory;
  if (!usable(u, force)) return ROBOT_WRONG_INPUT;
  for (int k = 0; k < ROBOT_SHAPE; k++) if (!isfinite(x[k])) return ROBOT_WRONG_INPUT;
  memcpy(m->w.x, x, sizeof m->w.x);
  int status = solve_from(&m->w, u, force, points, lengths);
  if (status != SOLVED) {
    memcpy(m->w.x, REST, sizeof m->w.x);
    status = solve_from(&m->w, u, force, points, lengths);
  }
  if (status != SOLVED && follow(m, u, force, points, lengths) == SOLVED) status = SOLVED;
  memcpy(x, m->w.x, sizeof m->w.x);
  return status;
}

int robot_gain(void *memory, const double x[ROBOT_SHAPE], const double u[ROBOT_INPUTS], const double force[3 * ROBOT_POINTS],
               int point, double gain[3 * ROBOT_INPUTS], double compliance[9 * ROBOT_POINTS]) {
  work *w = &((memory_of_statics *)memory)->w;
  double weights[ROWS * (NPOINT + NLEN)] = {0};
  if (!usable(u, force) || point < 0 || point >= ROBOT_POINTS) return ROBOT_WRONG_INPUT;
  for (int k = 0; k < ROBOT_SHAPE; k++) if (!isfinite(x[k])) return ROBOT_WRONG_INPUT;
  for (int k = 0; k < 3; k++) weights[k * (NPOINT + NLEN) + 3 * point + k] = 1;
  begin_statics(w, u, force);
  memcpy(w->x, x, sizeof w->x);
  memcpy(w->x[0], w->level_0, sizeof w->level_0);
  assemble(w, 0);
  if (factor(w)) return ROBOT_INDEFINITE;
  adjoint(w, u, 0, force, 3, weights, gain, compliance, 0, 0);
  return SOLVED;
}
