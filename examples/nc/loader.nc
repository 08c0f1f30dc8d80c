// Transfer, loader: takes the part from the mill to the rack
N10 G90 G64
N20 G00 X600
N30 M70                     // meets the mill
N40 G01 Z-250 F12000
N50 G04 P300                // the gripper closes
N60 M70                     // the mill has released its clamp
N70 G01 Z-20 F9000
N80 G00 X80
N90 G61
N100 G01 Z-180 F9000
N110 G04 X0.3               // the gripper opens
N120 Z-5
N130 G00 X0 Z0
N140 M30
