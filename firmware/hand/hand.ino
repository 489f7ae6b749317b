// The hand, on a Mega: a push button, nine potentiometers in the joints, five force sensors, six servos.
#include <rtagent.h>

const uint8_t channels[] = {2, A2, A3, A4, A5, A6, A7, A8, A9, A10, A11, A12, A13, A14, A15};
const uint8_t servos[] = {3, 5, 6, 9, 10, 11};
rtagent::Board board(channels, servos);

void setup() { board.begin<1000000>(); }

void loop() { board.turn(); }
