/* Reads samples, a line each: time, points, measured pressures, measured tensions; "nan" where something is not measured. Writes the
   commands: pressures in Pa, tensions in N. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "controller.h"
#include "sizes.h"

static int numbers(double *to, int count) {
  char word[64];
  for (int k = 0; k < count; k++) {
    if (scanf("%63s", word) != 1) return 0;
    to[k] = strtod(word, 0);
  }
  return 1;
}

int main(void) {
  void *controller = aligned_alloc(64, (size_t)(controller_size() + 63) / 64 * 64);
  double time, points[3 * POINTS_TRACKED], measured[2][ACTUATORS], command[2][ACTUATORS];
  if (!controller) return 1;
  controller_open(controller);
  if (controller_prepare(controller)) return 1;
  while (numbers(&time, 1) && numbers(points, 3 * POINTS_TRACKED) && numbers(measured[0], 2 * ACTUATORS)) {
    if (controller_command(controller, time, INFINITY, points, measured[0], measured[1], command[0], command[1]) < 0) return 1;
    for (int k = 0; k < 2 * ACTUATORS; k++) printf("%.17g%c", command[k / ACTUATORS][k % ACTUATORS], k < 2 * ACTUATORS - 1 ? ' ' : '\n');
    if (controller_prepare(controller)) return 1;
  }
  free(controller);
  return 0;
}
