/* Statics, gain and motion of a robot, exported by tepm_opt. SI units throughout.

   Sizes, names and order of everything are in robot_sizes.h. All memory is the caller's: no function takes any from the heap, there is no
   global state but constants, and different memories may be used by different threads at once. Memory has to be aligned to 64 bytes.
   GCC or Clang (vector extensions, C11); only the mathematical library is needed.

   u      inputs, ROBOT_INPUTS numbers: pressures in Pa, then tensions in N
   force  known forces on the reference points in the tracker's frame G, 3 * ROBOT_POINTS numbers in N: x, y, z of s1, then of s2 …
   x      shape, ROBOT_SHAPE numbers in m in the base's frame: level by level from the base, node by node, x, y, z
   points reference points in G, 3 * ROBOT_POINTS numbers in m; the last three are the tip
   lengths of the actuators, ROBOT_ACTUATORS numbers in m */
#ifndef ROBOT_H
#define ROBOT_H
#include <stddef.h>

#include "robot_sizes.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What functions return. Only ROBOT_SOLVED leaves results to rely on. */
enum {
  ROBOT_SOLVED = 0,
  ROBOT_UNSTABLE = 1,      /* an equilibrium, but its stiffness has a negative eigenvalue */
  ROBOT_STALLED = 2,       /* no step lowers the energy */
  ROBOT_EXHAUSTED = 3,     /* too many iterations */
  ROBOT_INDEFINITE = 4,    /* no gain: the stiffness at x is not positive definite */
  ROBOT_DIVERGED = 5,      /* the motion left all bounds */
  ROBOT_STUCK = 6,         /* the motion has no solution nearby, however short its steps */
  ROBOT_COLLAPSED = 7,     /* an equilibrium of a network that has turned inside out */
  ROBOT_WRONG_INPUT = -1,  /* not a finite number, an input beyond ROBOT_LOWEST … ROBOT_HIGHEST, no such point, a time that is not above 0 */
  ROBOT_NOT_OPEN = -2,     /* a motion that was not opened, or has ended with an error */
  ROBOT_FORGOTTEN = -3     /* steps are so short that what acts late is not remembered: see ROBOT_HISTORY */
};

/* The robot at rest without inputs and forces, undeformed: where a first equilibrium is looked for. */
void robot_rest(double x[ROBOT_SHAPE]);

/* Bytes of memory that robot_statics and robot_gain need. */
size_t robot_memory(void);

/* Equilibrium under inputs and forces, from the shape x on, which is replaced; a shape nearby (the last one) makes it quick. Where that
   leads nowhere it is looked for from rest, and then along inputs and forces that grow from 0: at most some 10 000 Newton steps. */
int robot_statics(void *memory, const double u[ROBOT_INPUTS], const double force[3 * ROBOT_POINTS], double x[ROBOT_SHAPE],
                  double points[3 * ROBOT_POINTS], double lengths[ROBOT_ACTUATORS]);

/* Gain of reference point `point` (0 … ROBOT_POINTS - 1, the last one is the tip) at an equilibrium x that robot_statics found:
   gain        by the inputs, row by row, 3 x ROBOT_INPUTS in m/Pa and m/N
   compliance  by the forces, row by row, 3 x (3 * ROBOT_POINTS) in m/N */
int robot_gain(void *memory, const double x[ROBOT_SHAPE], const double u[ROBOT_INPUTS], const double force[3 * ROBOT_POINTS], int point,
               double gain[3 * ROBOT_INPUTS], double compliance[9 * ROBOT_POINTS]);

/* Bytes of memory that a motion needs. */
size_t robot_motion_memory(void);

/* Begin a motion at rest in an equilibrium x that robot_statics found under these inputs and forces. */
int robot_motion_open(void *memory, const double x[ROBOT_SHAPE], const double u[ROBOT_INPUTS], const double force[3 * ROBOT_POINTS]);

/* Move on by `duration` in s, over which inputs and forces change linearly from those of the last call to these, in equal implicit steps
   of at most `longest` s (0.01 is a good choice), which are halved where that is needed. Returns ROBOT_SOLVED, or an error that ends the motion. */
int robot_motion_step(void *memory, const double u[ROBOT_INPUTS], const double force[3 * ROBOT_POINTS], double duration, double longest,
                      double points[3 * ROBOT_POINTS], double lengths[ROBOT_ACTUATORS]);

/* Shape in m, and its velocity in m/s, where the motion stands. */
void robot_motion_state(const void *memory, double x[ROBOT_SHAPE], double velocity[ROBOT_SHAPE]);

#ifdef __cplusplus
}
#endif
#endif
