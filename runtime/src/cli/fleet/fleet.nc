// A machine of a fleet: moves, outputs an M code and waits, until the measurement ends.
G90 G54
L0 = 0
while (L0 < {rounds}) {
    L0 = L0 + 1
    G01 X10 F6000
    M100 VA1
    G04 P{dwell_ms}
    G01 X0
    M100 VA2
    G04 P{dwell_ms}
}
M30
