/* The arrays of the unrolled network: their sizes, and what lies in each. */

#include <stdint.h>

typedef struct {
    long batch, steps; /* B and T */
    long state;        /* D */
    long angles;       /* K */
    long stem;         /* P */
    long memory;       /* H */
    long layers;       /* L */
    long pairs;        /* Q; 0 without a canonical frame */
    float decay;       /* factor on the gradient of a state, at every step back */
    float bound;       /* of the log standard deviation of additive noise */
} Sizes;

/* The leading axis of all weights is M. With F = D + 4K, O = D + 2P + 3H and width W = P, or H
   without a stem. The columns of `state` are the output l, the stem's u and v, and the gates n, r
   and u; those of `hidden` are r, u and n. */
typedef struct {
    const float *state;        /* [F, O] */
    const float *gates;        /* [P, 3H] */
    const float *hidden;       /* [H, 3H] */
    const float *hidden_bias;  /* [H] */
    const float *mix;          /* [H + P, P], with stem and memory */
    const float *mix_bias;     /* [P] */
    const float *layers;       /* [L, W, W] */
    const float *layers_bias;  /* [L, W] */
    const float *output;       /* [W, D] */
    const float *noise_output; /* [W, D], or null without gains */
    const float *log_std;      /* [W, D], or null without noise */
    const float *log_std_bias; /* [D] */
    /* without the axis M: */
    const float *lowest, *highest;         /* [D] */
    const int64_t *angle_columns;          /* [K] */
    const float *angle_mean, *angle_scale; /* [K] */
    const int64_t *pair_columns;           /* [Q, 2], turned by the canonical frame */
    const int64_t *axis_columns;           /* [2, 2], the points that define the frame */
    const float *axis_scale;               /* [2] */
} Weights;

/* What the forward pass reads: terms [M, B, T, O], state [M, B, D], hidden [M, B, H]. With
   multiplicative noise gain [M, B, T, W], with additive noise noise [M, B, T, D]; else null. */
typedef struct {
    const float *terms, *state, *hidden, *gain, *noise;
} Inputs;

/* Offsets of a step's values in `tape`: features f [F], h_t [H], h_{t+1} [H], p [P], u [P], v [P],
   the gates r, u, n and g_n [4H], y_0 … y_L [L + 1, W] and the layers' sums [L, W]. With a
   canonical frame, its cos φ, sin φ and 1/r [3], and the change of the state [D]. */
typedef struct {
    long features, before, after, stem, u, v, gates, top, sums, frame, change, size;
} Tape;

/* Offsets of a step's values in `gradients`: the gradients of the terms [O] and of g_n [H], which
   follow each other, of the mix [P] and of the layers' sums [L, W]. */
typedef struct {
    long terms, stem, gates, mix, sums, size;
} Gradients;

typedef struct {
    long D, K, P, H, L, Q, F, O, W;
    Tape tape;
    Gradients gradients;
} Layout;

static Layout layout(const Sizes *sizes)
{
    Layout n = {.D = sizes->state, .K = sizes->angles, .P = sizes->stem, .H = sizes->memory,
                .L = sizes->layers, .Q = sizes->pairs};
    n.F = n.D + 4 * n.K;
    n.O = n.D + 2 * n.P + 3 * n.H;
    n.W = n.P ? n.P : n.H;
    Tape *tape = &n.tape;
    tape->before = n.F;
    tape->after = tape->before + n.H;
    tape->stem = tape->after + n.H;
    tape->u = tape->stem + n.P;
    tape->v = tape->u + n.P;
    tape->gates = tape->v + n.P;
    tape->top = tape->gates + 4 * n.H;
    tape->sums = tape->top + (n.L + 1) * n.W;
    tape->frame = tape->sums + n.L * n.W;
    tape->change = tape->frame + (n.Q ? 3 : 0);
    tape->size = tape->change + (n.Q ? n.D : 0);
    n.gradients.stem = n.D;
    n.gradients.gates = n.D + 2 * n.P;
    n.gradients.mix = n.O + n.H;
    n.gradients.sums = n.gradients.mix + n.P;
    n.gradients.size = n.gradients.sums + n.L * n.W;
    return n;
}
