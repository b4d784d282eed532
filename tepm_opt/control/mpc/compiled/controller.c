/* The controller with its data: what controller.h declares. */

void controller_open(void *memory) {
  static const course way = {ROWS, LEVELS, INPUTS, LOADS, FORCES, LENGTHS, TIPS, POINTS, MAPPED, THETA, MASSES, BY, BASIS, VALUES, FREE};
  settings set;
  memcpy(&set, SETTINGS, sizeof set);
  step_open(memory, &set, &way, modal, FIRST_PRESSURES, FIRST_TENSIONS, AHEAD);
}

long controller_size(void) { return step_size(); }
int controller_prepare(void *memory) { return step_prepare(memory); }

int controller_command(void *memory, double time, double deadline, const double *points, const double *measured_pressures,
                       const double *measured_tensions, double *pressures, double *tensions) {
  step *o = memory;
  if (step_feedback(o, time, deadline, points, measured_pressures, measured_tensions)) return -1;
  memcpy(pressures, o->out.pressures, sizeof o->out.pressures);
  memcpy(tensions, o->out.tensions, sizeof o->out.tensions);
  return (int)o->out.status[0];
}
