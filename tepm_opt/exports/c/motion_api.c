/* What robot.h declares of motion, on the loops above. */

typedef struct {
  carried c;
  work w;
  pair p;
  long rows; /* of inputs that are remembered: the first of all, then the latest; 0 where the motion is not open */
  int dropped;
  double time[ROBOT_HISTORY], row[ROBOT_HISTORY][NINPUT], observed[ROBOT_HISTORY][NOBS], trajectory[ROBOT_HISTORY][2 * (NLEV + 1) * NB];
} memory_of_motion;

size_t robot_motion_memory(void) { return sizeof(memory_of_motion); }

int robot_motion_open(void *memory, const double x[ROBOT_SHAPE], const double u[ROBOT_INPUTS],
                      const double force[3 * ROBOT_POINTS]) {
  memory_of_motion *o = memory;
  memset(o, 0, sizeof *o);
  if (!usable(u, force)) return ROBOT_WRONG_INPUT;
  for (int k = 0; k < ROBOT_SHAPE; k++) if (!isfinite(x[k])) return ROBOT_WRONG_INPUT;
  memcpy(o->c.fine.x, x, sizeof o->c.fine.x);
  memcpy(o->row[0], u, NU * sizeof(double));
  memcpy(o->row[0] + NU, force, NEXT * sizeof(double));
  o->rows = 1;
  return SOLVED;
}

int robot_motion_step(void *memory, const double u[ROBOT_INPUTS], const double force[3 * ROBOT_POINTS], double duration,
                      double longest, double points[3 * ROBOT_POINTS], double lengths[ROBOT_ACTUATORS]) {
  memory_of_motion *o = memory;
  if (!o->rows) return ROBOT_NOT_OPEN;
  if (!usable(u, force) || !(duration > 0) || !(longest > 0) || !isfinite(duration)) return ROBOT_WRONG_INPUT;
  if (o->rows == ROBOT_HISTORY) {
    memmove(o->time + 1, o->time + 2, (ROBOT_HISTORY - 2) * sizeof *o->time);
    memmove(o->row + 1, o->row + 2, (ROBOT_HISTORY - 2) * sizeof *o->row);
    o->rows--;
    o->dropped = 1;
  }
  long next = o->rows, now = next - 1;
  memset(&o->w, 0, sizeof o->w);
  for (int k = 0; k < NTHETA; k++) o->w.packed_theta[k] = (vector){0} + (o->w.theta[k] = THETA[k]);
  stepper m = {.scheme = IMPLICIT, .tolerance = TOLERANCE, .max_correction = MAX_CORRECTION, .divisor = 1};
  motion *moves = &m.motion;
  o->time[next] = o->time[now] + duration;
  memcpy(o->row[next], u, NU * sizeof(double));
  memcpy(o->row[next] + NU, force, NEXT * sizeof(double));
  *moves = (motion){.inputs = {.time = o->time, .rows = o->row[0], .samples = next + 1},
                    .records = {o->observed[0], o->trajectory[0], 0}, .ends = &next, .ends_left = 1, .sample = now ? next : 0,
                    .phase = now ? TO_TAKE_STOCK : TO_BEGIN, .t = o->time[now], .span = longest};
  memset(&o->p, 0, sizeof o->p);
  const double *arg[] = {THETA};
  double *res[] = {moves->inputs.delay};
  run(delay, arg, res);
  double late = fmax(moves->inputs.delay[COMMANDS], moves->inputs.delay[FORCES]);
  if (o->dropped && o->time[now] - late < o->time[1]) return ROBOT_FORGOTTEN;
  move_on(&m, &o->w, &o->c, &o->p);
  if (moves->status != SOLVED) { o->rows = 0; return moves->status; }
  memcpy(points, o->observed[next], (NOBS - NU / 2) * sizeof(double));
  memcpy(lengths, o->observed[next] + NOBS - NU / 2, NU / 2 * sizeof(double));
  o->rows++;
  return SOLVED;
}

void robot_motion_state(const void *memory, double x[ROBOT_SHAPE], double velocity[ROBOT_SHAPE]) {
  const memory_of_motion *o = memory;
  memcpy(x, o->c.fine.x, sizeof o->c.fine.x);
  memcpy(velocity, o->c.fine.v, sizeof o->c.fine.v);
}
