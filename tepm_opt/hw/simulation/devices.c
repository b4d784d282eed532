/* From commands to the motors' forces, tick by tick: regulators, tendon motors, and every imperfection that has a state or a force.

   Each stage does what the Python class of the same name in imperfections/ does, and has its numbers: scalars, then arrays with a
   number a channel, then its state. Channels are the actuators, or, of a stage of the edges, the vertical edges, actuator by actuator, with
   the levels side by side. What a stage takes and gives are the values at a tick's start and end, between which they are linear. */

typedef struct { /* a value over time; the order is engine.py's, as in timeline.py */
  const integer *at;              /* (knots,) steps */
  const double *value, *slope;    /* (knots, size) from a knot on; a second */
  const unsigned char *moves;     /* (knots,) whether the slope is not 0 */
  integer knots, size;
} timeline;

typedef struct { /* kinds stand before this text, from engine.py */
  integer kind, count; /* of operators or branches, where there are several */
  double *numbers;
} stage;

typedef struct { /* the order is engine.py's */
  mechanics network;
  integer tick;                            /* steps between updates */
  integer ticks, follows_shape;            /* whether there is anything to update; whether from lengths and rates */
  integer actuators, modules, points;      /* all modules' actuators; reference points */
  const integer *stages;                   /* how many act on the regulators' pressures, on the muscles', on the tensions, on the edges, on the tip */
  stage *regulators, *muscles, *tendons, *along, *around; /* their stages, in their order */
  double area, pressure_grid, tension_grid, winding; /* m2, Pa, N, N/s; grids are 0 where there is none */
  const double *weights, *turn, *base, *external;    /* (points, levels + 1), (3, 3), (3,), (points, 3): of the points, of the frame G */
  double *pressure, *tension;              /* (actuators,) measured by monitors */
  double *loaded;                          /* (points, 3): commanded forces that the network carries */
  double *work;                            /* 2 x 3 actuators, 2 x points x 3, 2 x 2 actuators, 4 x (nodes, width) */
  const double *free_fall, *shaking;        /* (3,) without the base's motion; (sines, 5): angular frequency, phase, acceleration of the base */
  double began;                            /* s: time in the session at the start */
  integer sines, now;                      /* of the base's motion; steps since the start */
} rig;

static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double smaller(double a, double b) { return a < b ? a : b; }

/* --- timelines --- */

static integer knot_at(const timeline *t, integer k, integer now) {
  while (k + 1 < t->knots && t->at[k + 1] <= now) k++;
  return k;
}

static void between(const timeline *t, integer k, double step, integer start, integer end, double *out) {
  const double *value = t->value + k * t->size, *slope = t->slope + k * t->size;
  for (integer i = 0; i < t->size; i++) {
    out[i] = t->moves[k] ? value[i] + (start - t->at[k]) * step * slope[i] : value[i];
    out[t->size + i] = t->moves[k] ? value[i] + (end - t->at[k]) * step * slope[i] : value[i];
  }
}

/* --- stages of pressures: p is (2, count) --- */

static void unequal_lag(const stage *s, double *p, integer count, double duration) {
  double *state = s->numbers + 2;
  for (integer i = 0; i < count; i++) {
    const double before = state[i], start = p[i], end = p[count + i];
    const double constant = start + end > 2 * before ? s->numbers[0] : s->numbers[1];
    const double behind = (end - start) / duration * constant;
    state[i] = end - behind + (before - start + behind) * exp(-duration / constant);
    p[i] = before, p[count + i] = state[i];
  }
}

static const double ATMOSPHERE = 101325; /* Pa */

static double flow(double upstream, double downstream, double critical_ratio) {
  const double over = larger(smaller(downstream / upstream, 1) - critical_ratio, 0) / (1 - critical_ratio);
  return upstream * sqrt(1 - over * over);
}

static void orifices(const stage *s, double *p, integer count, double duration) {
  const double rate = s->numbers[0], supply = s->numbers[1], band = s->numbers[2], critical_ratio = s->numbers[3];
  double *state = s->numbers + 4;
  for (integer i = 0; i < count; i++) {
    const double before = state[i], error = (p[i] + p[count + i]) / 2 - before, inside = larger(before, 0) + ATMOSPHERE;
    const double through = error > 0 ? flow(supply + ATMOSPHERE, inside, critical_ratio) : flow(inside, ATMOSPHERE, critical_ratio);
    state[i] = before + error * -expm1(-(rate * through * duration) / larger(fabs(error), band));
    p[i] = before, p[count + i] = state[i];
  }
}

static void leak(const stage *s, double *p, integer count, double duration) {
  const double constant = s->numbers[0], critical_ratio = s->numbers[1], *share = s->numbers + 2;
  double *state = s->numbers + 2 + count;
  for (integer i = 0; i < count; i++) {
    if (share[i] > 0) {
      const double before = state[i], loss = share[i] * flow(larger(before, 0) + ATMOSPHERE, ATMOSPHERE, critical_ratio);
      const double goal = (p[i] + p[count + i]) / 2 - loss;
      p[i] = before, p[count + i] = larger(goal + (before - goal) * exp(-duration / constant), 0);
    }
    state[i] = p[count + i];
  }
}

static double soft(double pressure, double threshold, double softness) { /* log(1 + exp(x)), which does not overflow */
  const double x = (pressure - threshold) / softness;
  return softness * (larger(x, 0) + log1p(exp(-fabs(x))));
}

static void soft_zone(const stage *s, double *p, integer count) {
  for (integer i = 0; i < 2 * count; i++) p[i] = soft(p[i], s->numbers[0], s->numbers[1]) - soft(0, s->numbers[0], s->numbers[1]);
}

static void play_stack(const stage *s, double *p, integer count) {
  const double *below = s->numbers, *above = below + s->count;
  double *state = s->numbers + 2 * s->count;
  for (integer end = 0; end < 2; end++)
    for (integer i = 0; i < count; i++) {
      double *value = p + end * count + i, sum = 0;
      for (integer k = 0; k < s->count; k++) {
        double *y = state + k * count + i;
        *y = smaller(larger(*y, *value - below[k]), *value + above[k]);
        sum += *y;
      }
      *value = sum / s->count;
    }
}

static void squeeze(const stage *s, double *p, integer count) {
  const double share = s->numbers[0], largest = s->numbers[1], exponent = s->numbers[2], *mixing = s->numbers + 3;
  for (integer end = 0; end < 2; end++) {
    double bulge[count], *value = p + end * count;
    for (integer i = 0; i < count; i++) bulge[i] = share * largest * pow(larger(value[i], 0) / largest, exponent);
    for (integer i = 0; i < count; i++)
      for (integer j = 0; j < count; j++) value[i] += bulge[j] * mixing[j * count + i];
  }
}

static void gain(const stage *s, double *p, integer count) {
  for (integer i = 0; i < 2 * count; i++) p[i] *= s->numbers[i % count];
}

static void shift(const stage *s, double *p, integer count) {
  for (integer i = 0; i < 2 * count; i++) p[i] += s->numbers[i % count];
}

static void on_pressures(const stage *s, double *p, integer count, double duration) {
  switch (s->kind) {
    case UNEQUAL_LAG: unequal_lag(s, p, count, duration); break;
    case ORIFICES: orifices(s, p, count, duration); break;
    case LEAK: leak(s, p, count, duration); break;
    case SOFT_ZONE: soft_zone(s, p, count); break;
    case PLAY_STACK: play_stack(s, p, count); break;
    case SQUEEZE: squeeze(s, p, count); break;
    case GAIN: gain(s, p, count); break;
    case SHIFT: shift(s, p, count); break;
  }
}

/* --- LuGre friction, as lugre.py has it --- */

typedef struct { double stiffness, damping, breakaway, stribeck; } lugre;

/* Force at the start and the end of a tick; the bristle's bend is advanced exactly for a constant rate. */
static inline void rub(const lugre *b, double rate, double sliding, double duration, double *bend, double *start, double *end) {
  double limit = sliding / b->stiffness;
  if (b->breakaway > 1) limit *= 1 + (b->breakaway - 1) * exp(-(rate / b->stribeck) * (rate / b->stribeck));
  const double before = smaller(larger(*bend, -limit), limit), goal = copysign(limit, rate);
  *bend = goal + (before - goal) * exp(fabs(rate) * (-duration / larger(limit, 1e-12)));
  const double more = b->damping / duration * (*bend - before);
  *start = b->stiffness * before + more, *end = b->stiffness * *bend + more;
}

/* --- stages of tensions: t is (2, count); lengths and rates (count,) of the actuators --- */

static void take_up(const stage *s, double *t, const double *length, const double *rate, integer count, double duration) {
  const double slack = s->numbers[0], stiffness = s->numbers[1], rest = s->numbers[2];
  for (integer end = 0; end < 2; end++)
    for (integer i = 0; i < count; i++) {
      const double now = end ? length[i] + rate[i] * duration : length[i];
      t[end * count + i] = larger(t[end * count + i] - stiffness * larger(slack - (now - rest), 0), 0);
    }
}

static void sheath(const stage *s, double *t, const double *rate, integer count, double duration) {
  const lugre bristles = {s->numbers[2], s->numbers[3], s->numbers[4], s->numbers[5]};
  for (integer i = 0; i < count; i++) {
    double start, end;
    rub(&bristles, rate[i], s->numbers[0] + s->numbers[1] * t[count + i], duration, s->numbers + 6 + i, &start, &end);
    t[i] = larger(t[i] + start, 0), t[count + i] = larger(t[count + i] + end, 0);
  }
}

static void load_cell(const stage *s, double *t, integer count) {
  const double bend = s->numbers[0], largest = s->numbers[1], *loss = s->numbers + 2, *zero = loss + count;
  for (integer i = 0; i < 2 * count; i++) {
    const integer k = i % count;
    const double bent = loss[k] != 0 ? bend * t[i] * (1 - t[i] / largest) : 0;
    t[i] = larger(t[i] * (1 - loss[k]) + bent + zero[k], 0);
  }
}

static void slip(const stage *s, double *t, integer count, double duration) {
  double *clock = s->numbers;
  const double instant = s->numbers[1], slides = s->numbers[2], *share = s->numbers + 3;
  for (integer end = 0; end < 2; end++) {
    const double over = smaller(larger((*clock - instant) / slides, 0), 1);
    for (integer i = 0; i < count; i++) t[end * count + i] *= 1 - share[i] * over;
    if (!end) *clock += duration;
  }
}

static void on_tensions(const stage *s, double *t, const double *length, const double *rate, integer count, double duration) {
  switch (s->kind) {
    case TAKE_UP: take_up(s, t, length, rate, count, duration); break;
    case SHEATH: sheath(s, t, rate, count, duration); break;
    case LOAD_CELL: load_cell(s, t, count); break;
    case SLIP: slip(s, t, count, duration); break;
  }
}

/* --- forces along the vertical edges, added to `push` at both ends of the tick; all (count,) with count = nodes x width --- */

static void bristles(const stage *s, const double *length, const double *rate, integer count, double duration, double *push) {
  const lugre each = {s->numbers[0], s->numbers[1], s->numbers[2], s->numbers[3]};
  const double sliding = s->numbers[4], *share = s->numbers + 5, *rest = share + count;
  double *bend = s->numbers + 5 + 2 * count;
  for (integer i = 0; i < count; i++) {
    double start, end;
    rub(&each, rate[i], sliding + share[i] * fabs(length[i] - rest[i]), duration, bend + i, &start, &end);
    push[i] -= start, push[count + i] -= end;
  }
}

static void prony(const stage *s, const double *rate, integer count, double duration, double *push) {
  const double *constants = s->numbers, *stiffness = s->numbers + s->count;
  double *force = s->numbers + s->count + count;
  for (integer branch = 0; branch < s->count; branch++) {
    const double constant = constants[branch], kept = exp(-duration / constant);
    for (integer i = 0; i < count; i++) {
      double *pull = force + branch * count + i;
      push[i] -= *pull;
      *pull = *pull * kept + stiffness[i] * constant * rate[i] * (1 - kept);
      push[count + i] -= *pull;
    }
  }
}

static double fung(double stiffness, double rest, double growth, double length) {
  const double strain = larger(length / rest - 1, 0);
  return stiffness * rest * (expm1(growth * strain) / growth - strain);
}

static void exponential(const stage *s, const double *length, const double *rate, integer count, double duration, double *push) {
  const double growth = s->numbers[0], *stiffness = s->numbers + 1, *rest = stiffness + count;
  for (integer i = 0; i < count; i++) {
    push[i] -= fung(stiffness[i], rest[i], growth, length[i]);
    push[count + i] -= fung(stiffness[i], rest[i], growth, length[i] + rate[i] * duration);
  }
}

static void warming(const stage *s, const double *length, const double *rate, integer count, double duration, double *push) {
  double *clock = s->numbers;
  const double full = s->numbers[1], *change = s->numbers + 2, *rest = change + count;
  const double start = smaller(*clock / full, 1);
  *clock += duration;
  const double end = smaller(*clock / full, 1);
  for (integer i = 0; i < count; i++) {
    push[i] -= start * change[i] * (length[i] - rest[i]);
    push[count + i] -= end * change[i] * (length[i] + rate[i] * duration - rest[i]);
  }
}

static void along_edges(const stage *s, const double *length, const double *rate, integer count, double duration, double *push) {
  switch (s->kind) {
    case BRISTLES: bristles(s, length, rate, count, duration, push); break;
    case PRONY: prony(s, rate, count, duration, push); break;
    case EXPONENTIAL: exponential(s, length, rate, count, duration, push); break;
    case WARMING: warming(s, length, rate, count, duration, push); break;
  }
}

/* --- the rig --- */

/* Lengths and rates of the vertical edges, (nodes, width) each. */
static void measure(const mechanics *m, double *length, double *rate) {
  const integer row = row_of(m);
  for (integer i = 0; i < NODES; i++)
    for (integer j = 0; j < m->width; j++) {
      const double *x = m->x + 3 * i * row + LANES + j, *v = m->v + 3 * i * row + LANES + j;
      double square = 0, along = 0;
      for (integer k = 0; k < 3; k++) {
        const double span = x[k * row] - x[k * row - 1];
        square += span * span, along += span * (v[k * row] - v[k * row - 1]);
      }
      length[i * m->width + j] = sqrt(square), rate[i * m->width + j] = along / sqrt(square);
    }
}

/* Sums over the vertical edges (nodes, width) of each actuator, (modules, nodes). */
static void of_actuators(const rig *r, const double *edges, double *sums) {
  const integer segments = r->network.levels / r->modules;
  for (integer h = 0; h < r->modules; h++)
    for (integer i = 0; i < NODES; i++) {
      double sum = 0;
      for (integer j = 0; j < segments; j++) sum += edges[i * r->network.width + h * segments + j];
      sums[h * NODES + i] = sum;
    }
}

/* Set points on their grid, held for a tick. */
static void quantise(double *values, double grid, integer count) {
  if (grid == 0) return;
  for (integer i = 0; i < count; i++) values[i] = values[count + i] = rint((values[i] + values[count + i]) / 2 / grid) * grid;
}

/* Tensions at the motors: limited in rate, released at once where disabled. */
static void wind(const rig *r, double *goal, const double *enabled, double duration) {
  const integer count = r->actuators;
  const double largest = r->winding * duration;
  for (integer i = 0; i < count; i++) {
    const double start = r->tension[i] * enabled[i];
    if (isinf(largest)) {
      goal[i] *= enabled[i], goal[count + i] *= enabled[i];
    } else {
      const double change = smaller(larger(goal[count + i] * enabled[i] - start, -largest), largest);
      goal[i] = start, goal[count + i] = start + change;
    }
    r->tension[i] = goal[count + i];
  }
}

/* Forces of the motors from here to `duration` later under commands at both ends, (2, 3 actuators). */
static void drive(rig *r, double *command, double duration) {
  mechanics *m = &r->network;
  const integer count = r->actuators, edges = NODES * m->width;
  double *pressure = r->work + 6 * count + 6 * r->points, *tension = pressure + 2 * count, *length = tension + 2 * count;
  double *rate = length + edges, *push = rate + edges, *axial = command; /* no longer needed below */
  double lengths[count], rates[count], enabled[count];
  for (integer end = 0; end < 2; end++)
    for (integer i = 0; i < count; i++) {
      pressure[end * count + i] = command[3 * end * count + i];
      tension[end * count + i] = command[3 * end * count + count + i];
      enabled[i] = command[2 * count + i];
    }
  memset(push, 0, sizeof(double) * 2 * edges);
  if (r->follows_shape) {
    measure(m, length, rate);
    for (integer s = 0; s < r->stages[3]; s++) along_edges(r->along + s, length, rate, edges, duration, push);
    of_actuators(r, length, lengths), of_actuators(r, rate, rates);
  }
  quantise(pressure, r->pressure_grid, count);
  for (integer s = 0; s < r->stages[0]; s++) on_pressures(r->regulators + s, pressure, count, duration);
  memcpy(r->pressure, pressure + count, sizeof(double) * count);
  for (integer s = 0; s < r->stages[1]; s++) on_pressures(r->muscles + s, pressure, count, duration);
  quantise(tension, r->tension_grid, count);
  wind(r, tension, enabled, duration);
  for (integer s = 0; s < r->stages[2]; s++) on_tensions(r->tendons + s, tension, lengths, rates, count, duration);
  for (integer i = 0; i < 2 * count; i++) axial[i] = r->area * pressure[i] - tension[i];
  const integer segments = m->levels / r->modules;
  for (integer i = 0; i < NODES; i++)
    for (integer j = 0; j < m->levels; j++) {
      const integer muscle = j / segments * NODES + i, at = i * m->width + j;
      const double start = axial[muscle] + push[at], end = axial[count + muscle] + push[edges + at];
      m->push[at] = start, m->slope[at] = (end - start) / duration;
    }
}

/* Carry forces (points, 3) on the reference points in G, shared by the nodes of their levels; nothing where they are carried already. */
void carry(rig *r, const double *forces) {
  mechanics *m = &r->network;
  if (!memcmp(forces, r->loaded, sizeof(double) * 3 * r->points)) return;
  memcpy(r->loaded, forces, sizeof(double) * 3 * r->points);
  for (integer j = 0; j < m->levels; j++) {
    double total[3] = {0, 0, 0};
    for (integer p = 0; p < r->points; p++)
      for (integer k = 0; k < 3; k++)
        total[k] += r->weights[p * (m->levels + 1) + j + 1] / NODES * (forces[3 * p + k] + r->external[3 * p + k]);
    for (integer k = 0; k < 3; k++) m->load[3 * j + k] = total[0] * r->turn[k] + total[1] * r->turn[3 + k] + total[2] * r->turn[6 + k];
  }
  rest_on(m);
}

/* A reference point's place over the base, or its velocity, in the axes of G, of all nodes' (nodes, 3, row). */
static void turned(const rig *r, const double *of, integer point, double *out) {
  const mechanics *m = &r->network;
  const integer row = row_of(m);
  double place[3] = {0, 0, 0};
  for (integer j = 0; j <= m->levels; j++) {
    const double weight = r->weights[point * (m->levels + 1) + j];
    if (weight == 0) continue;
    for (integer k = 0; k < 3; k++) {
      double sum = 0;
      for (integer i = 0; i < NODES; i++) sum += of[(3 * i + k) * row + LANES - 1 + j];
      place[k] += weight * (sum / NODES);
    }
  }
  for (integer k = 0; k < 3; k++) out[k] = r->turn[3 * k] * place[0] + r->turn[3 * k + 1] * place[1] + r->turn[3 * k + 2] * place[2];
}

/* --- forces on the tip, added to `force` (3,); place and velocity (3,) in G --- */

static void wall(const double *numbers, const double *place, const double *velocity, double *force) {
  const double *at = numbers, *normal = numbers + 3, stiffness = numbers[6], damping = numbers[7];
  double depth = 0, away = 0;
  for (integer k = 0; k < 3; k++) depth -= (place[k] - at[k]) * normal[k], away += velocity[k] * normal[k];
  const double push = depth > 0 ? larger(stiffness * depth - damping * away, 0) : 0;
  for (integer k = 0; k < 3; k++) force[k] += push * normal[k];
}

static void tether(const double *numbers, const double *place, double *force) {
  for (integer k = 0; k < 3; k++) force[k] += numbers[3] * (numbers[k] - place[k]);
}

static void drag(const double *numbers, const double *velocity, double *force) {
  const double speed = sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]);
  for (integer k = 0; k < 3; k++) force[k] -= numbers[0] * speed * velocity[k];
}

static void meet(const rig *r, double *force) {
  if (!r->stages[4]) return;
  double place[3], velocity[3];
  turned(r, r->network.x, r->points - 1, place), turned(r, r->network.v, r->points - 1, velocity);
  for (integer k = 0; k < 3; k++) place[k] += r->base[k];
  for (integer s = 0; s < r->stages[4]; s++) {
    const stage *each = r->around + s;
    switch (each->kind) {
      case WALL: wall(each->numbers, place, velocity, force); break;
      case TETHER: tether(each->numbers, place, force); break;
      case DRAG: drag(each->numbers, velocity, force); break;
    }
  }
}

/* Nodes (levels + 1, nodes, 3) in the base frame and reference points (points, 3) in G; whether no node has left all bounds. */
static int look(const rig *r, double *nodes, double *points) {
  const mechanics *m = &r->network;
  const integer row = row_of(m);
  int bounded = 1;
  for (integer i = 0; i < NODES; i++)
    for (integer k = 0; k < 3; k++)
      for (integer j = 0; j <= m->levels; j++) {
        const integer at = (3 * i + k) * row + LANES - 1 + j;
        nodes[3 * (j * NODES + i) + k] = m->x[at];
        bounded &= fabs(m->x[at] - m->rest[at]) < m->bound; /* no where it is not a number */
      }
  for (integer p = 0; p < r->points; p++) {
    turned(r, m->x, p, points + 3 * p);
    for (integer k = 0; k < 3; k++) points[3 * p + k] += r->base[k];
  }
  return bounded;
}

/* What masses feel of the base's motion at a time since the start: it sets in within FADE, as a run begins at rest. */
static void shake(rig *r, double passed) {
  mechanics *m = &r->network;
  if (!r->sines) return;
  double *fall = (double *)m->fall;
  const double part = smaller(passed / FADE, 1);
  for (integer k = 0; k < 3; k++) fall[k] = r->free_fall[k];
  for (integer s = 0; s < r->sines; s++) {
    const double *sine = r->shaking + 5 * s, wave = part * part * sin(sine[0] * (r->began + passed) + sine[1]);
    for (integer k = 0; k < 3; k++) fall[k] -= wave * sine[2 + k];
  }
  rest_on(m);
}

/* Advance to a step. */
static void advance(rig *r, integer until, const timeline *commands, const timeline *forces, integer *command, integer *force) {
  mechanics *m = &r->network;
  double *values = r->work, *pushed = r->work + 6 * r->actuators;
  while (r->now < until) {
    *command = knot_at(commands, *command, r->now), *force = knot_at(forces, *force, r->now);
    integer end = until;
    if (*command + 1 < commands->knots && commands->at[*command + 1] < end) end = commands->at[*command + 1];
    if (*force + 1 < forces->knots && forces->at[*force + 1] < end) end = forces->at[*force + 1];
    if ((r->ticks || forces->moves[*force]) && r->now + r->tick < end) end = r->now + r->tick;
    between(commands, *command, m->step, r->now, end, values);
    between(forces, *force, m->step, r->now, end, pushed);
    for (integer i = 0; i < forces->size; i++) pushed[i] = (pushed[i] + pushed[forces->size + i]) / 2;
    meet(r, pushed + forces->size - 3);
    drive(r, values, (end - r->now) * m->step);
    carry(r, pushed);
    shake(r, (r->now + end) / 2.0 * m->step);
    move(m, end - r->now);
    r->now = end;
  }
}

/* Advance to each of some steps and tell what is there then; the number of those reached before a node left all bounds.
   `nodes` (frames, levels + 1, nodes, 3), `points` (frames, points, 3), `pressures` and `tensions` (frames, actuators). */
integer record(
  rig *r, const timeline *commands, const timeline *forces, integer frames, const integer *at,
  double *nodes, double *points, double *pressures, double *tensions
) {
  integer command = 0, force = 0;
  for (integer f = 0; f < frames; f++) {
    advance(r, at[f], commands, forces, &command, &force);
    if (!look(r, nodes + f * 3 * (r->network.levels + 1) * NODES, points + f * 3 * r->points)) return f;
    memcpy(pressures + f * r->actuators, r->pressure, sizeof(double) * r->actuators);
    memcpy(tensions + f * r->actuators, r->tension, sizeof(double) * r->actuators);
  }
  return frames;
}

/* Forces (places, levels, nodes, 3) on the nodes of a network that stands still at places (places, levels, nodes, 3), in metres from rest,
   under motors' forces (places, nodes, width) and the loads it carries. Positions and velocities are left as they are. */
void force_at_rest(const rig *r, integer places, const double *place, const double *push, double *force) {
  mechanics m = r->network;
  const integer row = row_of(&m), size = size_of(&m), edges = NODES * m.width;
  double *upper = work_of(&m, 0), *lower = work_of(&m, 1), *x = work_of(&m, 2), *v = work_of(&m, 3);
  memset(v, 0, sizeof(double) * size);
  for (integer p = 0; p < places; p++) {
    m.push = (double *)push + p * edges;
    memcpy(x, m.rest, sizeof(double) * size);
    for (integer i = 0; i < NODES; i++)
      for (integer k = 0; k < 3; k++)
        for (integer j = 0; j < m.levels; j++)
          x[(3 * i + k) * row + LANES + j] += place[((p * m.levels + j) * NODES + i) * 3 + k];
    pull(&m, x, v, 0, upper, lower);
    for (integer i = 0; i < NODES; i++)
      for (integer k = 0; k < 3; k++)
        for (integer j = 0; j < m.levels; j++) {
          const integer at = (3 * i + k) * row + LANES + j;
          const double own = m.still[(3 * i + k) * m.width + j] / m.inverse_mass[i * m.width + j];
          force[((p * m.levels + j) * NODES + i) * 3 + k] = upper[at] + lower[at + 1] + own;
        }
  }
}
