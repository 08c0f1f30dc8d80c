while(1==1) { L1=L1+1 }
M30
