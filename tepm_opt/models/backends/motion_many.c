/* Motions of one network side by side. A lane of a pool is entered at any time, and moves with the others until it is over. */
typedef struct { work w; carried c; pair p; stepper m; } pool;

int pool_lanes(void) { return WIDTH; }
long pool_size(void) { return sizeof(pool); }

/* Empties a pool, and says how its motions go: steps adapt so that points err by about `goal`, or are equal (goal 0). */
void pool_open(pool *o, int scheme, double goal, int smooth, double tolerance, double max_correction) {
  memset(o, 0, sizeof *o);
  o->m = (stepper){.scheme = scheme, .adaptive = goal > 0, .tolerance = tolerance, .max_correction = max_correction, .goal = goal,
                   .close = CLOSE * goal, .smooth = smooth, .divisor = smooth ? RICHARDSON / 2. : 1};
}

/* Puts a motion in a lane, at rest in the equilibrium x. */
void pool_enter(pool *o, int lane, int hold, long samples, const double *time, const double *rows, double step, const double *theta,
                const double *x, double *observed, double *trajectory, const double *knots, long knots_left, const long *ends,
                long ends_left) {
  const double *arg[] = {theta};
  double late[2], *res[] = {late};
  run(delay, &o->w, arg, res);
  o->m.motion[lane] = (motion){.inputs = {.time = time, .rows = rows, .samples = samples, .hold = hold, .delay = {late[COMMANDS], late[FORCES]}},
                               .records = {observed, trajectory, 0}, .knots = knots, .knots_left = knots_left, .ends = ends,
                               .ends_left = ends_left, .phase = TO_BEGIN, .t = time[0], .span = step};
  real *all = (real *)&o->c, *effort[] = {&o->m.steps, &o->m.iterations, &o->m.factors, &o->m.halvings, &o->m.reached, &o->m.longest};
  for (size_t k = 0; k < sizeof o->c / sizeof *all; k++) LANE(all[k], lane) = 0;
  for (size_t k = 0; k < sizeof effort / sizeof *effort; k++) LANE(*effort[k], lane) = 0;
  for (int l = 0; l <= NLEV; l++) for (int k = 0; k < NB; k++) LANE(o->c.fine.x[l][k], lane) = *x++;
  for (int k = 0; k < NTHETA; k++) LANE(o->w.theta[k], lane) = theta[k];
  LANE(o->m.reached, lane) = time[0];
}

/* Moves all motions on until one of them is over, or for a number of rounds. */
void pool_move(pool *o, long rounds) { move_on(&o->m, &o->w, &o->c, &o->p, rounds); }

/* How far the motion in a lane is: the fields of its effort, its status and how many of its parts are left; returns whether it is over. */
int pool_look(const pool *o, int lane, double *info, int *status, long *left) {
  const stepper *m = &o->m;
  const double effort[] = {LANE(m->steps, lane),   LANE(m->iterations, lane), LANE(m->factors, lane), LANE(m->halvings, lane),
                           LANE(m->reached, lane), LANE(o->c.error, lane),    LANE(m->longest, lane)};
  memcpy(info, effort, sizeof effort);
  *status = m->motion[lane].status;
  *left = m->motion[lane].ends_left;
  return m->motion[lane].phase == OVER;
}

/* Empties a lane. */
void pool_leave(pool *o, int lane) { o->m.motion[lane] = (motion){.phase = OVER}; }
