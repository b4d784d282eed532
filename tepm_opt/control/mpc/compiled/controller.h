/* A predictive controller on one reference, exported by tepm_opt. Memory is the caller's; there is none else, but what the linearisation
   takes from the heap while it prepares, and no global state but constants. */
#ifndef CONTROLLER_H
#define CONTROLLER_H

/* Bytes that a controller needs, aligned as doubles are in vectors (64 bytes do). */
long controller_size(void);

/* A controller at rest under FIRST_PRESSURES in Pa and FIRST_TENSIONS in N of data.h. */
void controller_open(void *memory);

/* Does what the next sample is not needed for; best as soon as a command is sent. Returns 0, or 1 where the network cannot be linearised. */
int controller_prepare(void *memory);

/* Command for a sample.
   time: of the sample in s, since any zero; deadline: in s from this call, after which the last plan goes on (INFINITY for none);
   points: tracked, three numbers each in m, NaN where lost; measured pressures in Pa and tensions in N, or null;
   pressures, tensions: the commands, in Pa and N.
   Returns 0, the reason for which an older plan goes on (1 infeasible, 2 too many iterations, 3 not finite, 4 not convex, 5 inexact,
   6 late), or -1 where the network cannot be linearised and there is no command. */
int controller_command(void *memory, double time, double deadline, const double *points, const double *measured_pressures,
                       const double *measured_tensions, double *pressures, double *tensions);
#endif
