/* Reads rows of numbers: a time in s, the inputs, the forces on the reference points. Writes for each the equilibrium with the tip's gain,
   and where a motion is that begins at rest in the first and goes on from row to row:

     statics  status, points, lengths, gain row by row
     motion   status, points, lengths

   ./example < inputs.txt */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "robot.h"

#define LONGEST 0.01 /* s: of the motion's steps */

static int numbers(double *to, int count) {
  for (int k = 0; k < count; k++) if (scanf("%lf", to + k) != 1) return 0;
  return 1;
}

static void print(const double *values, int count) {
  for (int k = 0; k < count; k++) printf(" %.17g", values[k]);
}

static void *aligned(size_t bytes) { return aligned_alloc(64, (bytes + 63) / 64 * 64); }

int main(void) {
  static double u[ROBOT_INPUTS], force[3 * ROBOT_POINTS], x[ROBOT_SHAPE], start[ROBOT_SHAPE];
  static double points[3 * ROBOT_POINTS], lengths[ROBOT_ACTUATORS], gain[3 * ROBOT_INPUTS], compliance[9 * ROBOT_POINTS];
  void *memory = aligned(robot_memory()), *motion = aligned(robot_motion_memory());
  double time, last = 0;
  if (!memory || !motion) return 1;
  robot_rest(x);
  for (int row = 0; numbers(&time, 1) && numbers(u, ROBOT_INPUTS) && numbers(force, 3 * ROBOT_POINTS); row++, last = time) {
    int status = robot_statics(memory, u, force, x, points, lengths);
    if (status == ROBOT_SOLVED) status = robot_gain(memory, x, u, force, ROBOT_POINTS - 1, gain, compliance);
    printf("statics %d", status);
    if (status == ROBOT_SOLVED) { print(points, 3 * ROBOT_POINTS); print(lengths, ROBOT_ACTUATORS); print(gain, 3 * ROBOT_INPUTS); }
    printf("\n");
    if (!row) {
      memcpy(start, x, sizeof x);
      if (status != ROBOT_SOLVED || robot_motion_open(motion, start, u, force) != ROBOT_SOLVED) return 1;
      continue;
    }
    status = robot_motion_step(motion, u, force, time - last, LONGEST, points, lengths);
    printf("motion %d", status);
    if (status == ROBOT_SOLVED) { print(points, 3 * ROBOT_POINTS); print(lengths, ROBOT_ACTUATORS); }
    printf("\n");
  }
  free(memory);
  free(motion);
  return 0;
}
