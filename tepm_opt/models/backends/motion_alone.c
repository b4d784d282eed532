/* In place of motion_tangents.c where nothing is differentiated: motions without directions, and without the code for them. */
#define move_inputs_along(m, w, arg, at, duration, left) ((void)0)
#define keep_actuation_along(m, i) ((void)0)
#define stage_along(m, w, i, t, step, before, a, v_0) 0
#define step_along(m, h) ((void)0)
#define begin_along(m, t) ((void)0)
#define rest_along(m, w, s, t) 0
#define record_along(m, w, arg, d, k) ((void)0)
#define copy(m, to, from) ((void)0)
