/* The page of needles contains parts of d3-array, d3-color, d3-interpolate, d3-path and d3-shape.

Copyright 2010-2026 Mike Bostock

Permission to use, copy, modify, and/or distribute this software for any purpose
with or without fee is hereby granted, provided that the above copyright notice
and this permission notice appear in all copies.

THE SOFTWARE IS PROVIDED "AS IS" AND THE AUTHOR DISCLAIMS ALL WARRANTIES WITH
REGARD TO THIS SOFTWARE INCLUDING ALL IMPLIED WARRANTIES OF MERCHANTABILITY AND
FITNESS. IN NO EVENT SHALL THE AUTHOR BE LIABLE FOR ANY SPECIAL, DIRECT,
INDIRECT, OR CONSEQUENTIAL DAMAGES OR ANY DAMAGES WHATSOEVER RESULTING FROM LOSS
OF USE, DATA OR PROFITS, WHETHER IN AN ACTION OF CONTRACT, NEGLIGENCE OR OTHER
TORTIOUS ACTION, ARISING OUT OF OR IN CONNECTION WITH THE USE OR PERFORMANCE OF
THIS SOFTWARE. */
"use strict";(()=>{var __getOwnPropNames=Object.getOwnPropertyNames;var __esm=(fn,res,err)=>function(){if(err)throw err[0];try{return fn&&(res=(0,fn[__getOwnPropNames(fn)[0]])(fn=
0)),res}catch(e){throw err=[e],e}};function check(fault){if(fault)throw new TypeError(`the kernel refuses a problem: ${FAULTS[Number(fault)]}`)}function makeProblem(heap,fields2,arrays){
let addresses=ARRAYS.map(name=>arrays[name]?heap.put(arrays[name]):0),at=heap.structure(SIZES.map(name=>fields2[name]),
NUMBERS.map(name=>Number(fields2[name])),addresses),sizes=heap.take(24);check(heap.call.nf_check(at,sizes));let[
room,maxPoints]=heap.integers(sizes,2),places=Object.fromEntries(ARRAYS.map((name,i)=>[name,addresses[i]]));return{
at,sizes,fields:fields2,arrays:places,room:Number(room),maxPoints:Number(maxPoints)}}function rewrite(heap,problem,arrays){
for(let[name,array3]of Object.entries(arrays))heap.put(array3,problem.arrays[name]);check(heap.call.nf_check(problem.
at,problem.sizes))}function makeShapes(heap,{fields:fields2,room},points){let[sets,columns2,planes]=["sets","c\
olumns","planes"].map(name=>Number(fields2[name])),values={x:sets*room,u:planes*sets*room,slope:planes*sets*room,
constraints:(1+planes)*sets*points,track:2*planes*sets*points},derivatives={u_by:values.u,slope_by:values.slope,
constraints_by:planes*sets*points,track_by:planes*sets*points},counts=Object.fromEntries([...Object.entries({...values,
status:sets,passes:sets,nodes:1}),...Object.entries(derivatives).map(([name,count2])=>[name,count2*columns2])]),
places=Object.fromEntries(Object.entries(counts).map(([name,count2])=>[name,count2?heap.take(8*count2):0]));return{
...places,places,counts,room,planes,at:heap.structure([room,points],[],Object.values(places))}}var STATUS,FAULTS,
SIZES,NUMBERS,ARRAYS,compile,Heap,init_memory=__esm({"needlefit/mechanics/native/memory.js"(){"use strict";STATUS=
["converged","over-compressed","not converged","non-finite"],FAULTS=["","size","mesh","stop","guides","column",
"output","points"],SIZES="planes sets layers shapes terms numbers stop_count bevels inputs rays guides columns\
 max_iterations".split(" "),NUMBERS="length first_cell spacing element part tangent tolerance deepest".split("\
 "),ARRAYS="boundaries stops rigidity mu thickness friction law law_by turn base before_first within_first bef\
ore within held_tip guide_x turn_by column_of guide_columns".split(" "),compile=bytes=>WebAssembly.compile(bytes),
Heap=class _Heap{constructor(instance){this.call=instance.exports,this.memory=instance.exports.memory,this.top=
this.memory.buffer.byteLength}static async make(kernel){return new _Heap(await WebAssembly.instantiate(kernel,
{}))}take(bytes){let at=Math.ceil(this.top/64)*64;this.top=at+Number(bytes);let missing=this.top-this.memory.buffer.
byteLength;return missing>0&&this.memory.grow(Math.ceil(missing/65536)),at}put(array3,at=this.take(array3.byteLength)){
return new Uint8Array(this.memory.buffer,at).set(new Uint8Array(array3.buffer,array3.byteOffset,array3.byteLength)),
at}borrow(work){let{top}=this;try{return work()}finally{this.top=top}}evaluate(which,x2){return this.borrow(()=>{
let[at,out]=[this.put(Float64Array.of(x2)),this.take(8)];return this.call.nf_function(BigInt(which),1n,at,out),
this.floats(out,1)[0]})}floats(at,count2){return new Float64Array(this.memory.buffer,at,count2)}integers(at,count2){
return new BigInt64Array(this.memory.buffer,at,count2)}view(at){return new DataView(this.memory.buffer,at)}structure(integers,numbers,addresses){
let at=this.take(8*(integers.length+numbers.length)+4*addresses.length);return this.put(BigInt64Array.from(integers,
BigInt),at),this.put(Float64Array.from(numbers),at+8*integers.length),this.put(Uint32Array.from(addresses),at+
8*(integers.length+numbers.length)),at}}}});function checkInputs({length,element:element2},{guides},depth){if(!(depth>=0&&depth<length&&depth<=MAX_ELEMENTS*
element2))throw new RangeError(`the needle cannot be ${depth} mm deep`);if(guides.length>MAX_GUIDES)throw new RangeError(
`${guides.length} guides; there may be ${MAX_GUIDES}`);let ends=[depth-length,...guides.map(({x:x2})=>x2)];if(ends.
some((x2,i)=>i>0&&!(x2>ends[i-1])))throw new RangeError(`base and guides stand at ${ends} mm; they must increa\
se`)}function findToward(heap,{side,roll:roll2}){if(roll2===0)return[side,0];let quarters=Math.floor(roll2/90+
.5),rest=(roll2-90*quarters)*(Math.PI/180),[z,y2]=[3,4].map(which=>side*heap.evaluate(which,rest));return[[y2,
z],[-z,y2],[-y2,-z],[z,-y2]][(quarters%4+4)%4]}function listGuides(guides,planes){let listed=new Float64Array(
(1+2*planes)*MAX_GUIDES);return listed.set(guides.flatMap(({x:x2,y:y2,slope:slope4})=>[x2,...listHeld(y2,slope4,
0,planes)])),listed}function packInputs(heap,{bevel,base,guides,tip},model,planes){let[before,within]=[guides.
filter(({x:x2})=>x2<0),guides.filter(({x:x2})=>x2>=0)],toward=findToward(heap,bevel).slice(0,planes);return{turn:Float64Array.
from(toward,part2=>part2*bevel.strength/(model.pathAngle?1:model.spacing)),base:Float64Array.from([base.y,base.
slope,base.stageSlope,0,0,0].slice(0,3*planes)),before_first:BigInt64Array.of(0n,BigInt(before.length)),within_first:BigInt64Array.
of(0n,BigInt(within.length)),before:listGuides(before,planes),within:listGuides(within,planes),held_tip:Float64Array.
from(tip?listHeld(tip.y,tip.slope,tip.z??0,planes):Array(2*planes).fill(NaN))}}function pack(heap,model,inputs,planes,rays){
let{boundaries,rigidity,mu,thickness,friction,law}=model,arrays=Object.entries({boundaries,rigidity:[rigidity],
mu,thickness,friction,law});return makeProblem(heap,{planes,rays,sets:1,layers:mu.length,shapes:1,terms:model.
terms,numbers:law.length/mu.length,stop_count:1,bevels:1,inputs:1,guides:MAX_GUIDES,columns:0,max_iterations:model.
maxIterations,length:model.length,first_cell:model.firstCell,spacing:model.spacing,element:model.element,part:model.
pathAngle?LINEAR_CUT:model.switch,tangent:model.tangent,tolerance:model.tolerance,deepest:findDeepest(model)},
{...Object.fromEntries(arrays.map(([name,values])=>[name,Float64Array.from(values)])),stops:new Uint8Array(STOP_BYTES),
...packInputs(heap,inputs,model,planes)})}function readShape(heap,{places,planes,room},points){let[status,passes,
nodes]=["status","passes","nodes"].map(name=>Number(heap.integers(places[name],1)[0])),read=(name,count2,plane=0)=>heap.
floats(places[name]+8*plane*room,count2).slice(),readPlanes=name=>planes===1?read(name,nodes):Float64Array.of(
...read(name,nodes),...read(name,nodes,1)),x2=read("x",nodes);return{status:STATUS[status],passes,depth:x2[nodes-
1],planes,x:x2,u:readPlanes("u"),slope:readPlanes("slope"),constraints:read("constraints",(1+planes)*points),track:read(
"track",2*planes*points)}}function layOut(heap,base,{model,inputs,planes,rays},old){let{call}=heap;heap.top=base;
let problem=pack(heap,model,inputs,planes,rays),[shapes,done]=[makeShapes(heap,problem,problem.maxPoints),heap.
take(24)];call.nf_session_memory(problem.at,done);let[fixedBytes,bytes,scratchBytes]=heap.integers(done,3).map(
BigInt),[fixed,state,next,scratch]=[fixedBytes,bytes,bytes,scratchBytes].map(size2=>heap.take(size2));return call.
nf_session_begin(problem.at,fixed,state,scratch),old&&call.nf_session_copy(old.problem.at,problem.at,fixed,old.
state,old.scratch,state,scratch),{problem,shapes,done,fixed,state,next,scratch,bytes:Number(bytes),end:heap.top}}
var SAME_DEPTH,MAX_ELEMENTS,MAX_GUIDES,LINEAR_CUT,MAX_RAYS,STOP_BYTES,MOVE_BYTES,POSITION_BYTES,isPlanar,listHeld,
findDeepest,Session,init_needle=__esm({"needlefit/mechanics/native/needle.js"(){"use strict";init_memory();SAME_DEPTH=
1e-9,MAX_ELEMENTS=5e3,MAX_GUIDES=50,LINEAR_CUT=-1,MAX_RAYS=15e3,STOP_BYTES=48,MOVE_BYTES=24,POSITION_BYTES=64;
isPlanar=(heap,{bevel,tip})=>findToward(heap,bevel)[1]===0&&!tip?.z,listHeld=(y2,slope4,z,planes)=>[y2,slope4??
NaN,z,slope4===null?NaN:0].slice(0,2*planes);findDeepest=({length,element:element2})=>Math.min(length,MAX_ELEMENTS*
element2);Session=class _Session{static async begin(kernel,model,inputs){return new _Session(await Heap.make(kernel),
model,inputs)}failed=!1;planes=1;depth=0;rays=0;numbers=new Map;known=[];shape=null;memory=null;constructor(heap,model,inputs){
this.heap=heap,this.start=heap.top,this.model=model,this.inputs=inputs,this.#begin(model,inputs)}#begin(model,inputs,planes=model.
spatial||!isPlanar(this.heap,inputs)?2:this.planes){this.#layOut({model,inputs,planes,depth:0,rays:Math.ceil(findDeepest(
model)/model.spacing)}),this.go(0,inputs)}#layOut(fields2){Object.assign(this,fields2),this.memory=layOut(this.
heap,this.start,this)}go(depth,given){let{heap,inputs:before}=this,inputs={...given,guides:given.guides.toSorted(
(one,other)=>one.x-other.x)};if(checkInputs(this.model,inputs,depth),this.planes===1&&!isPlanar(heap,inputs)){
let path2=this.path();this.#begin(this.model,path2[0].inputs,2);for(let one of path2)this.go(one.depth,one.inputs)}
this.inputs=inputs,rewrite(heap,this.memory.problem,packInputs(heap,inputs,this.model,this.planes));let numbers=this.#count(
inputs),advance=()=>{let{problem,shapes,done,fixed,state:state2,next:next2,scratch}=this.memory;return[heap.call.
nf_session_advance(problem.at,fixed,state2,next2,scratch,shapes.at,depth,...numbers.map(BigInt),done),...heap.
integers(done,3)].map(Number)},[fault,stops,points,rays]=advance();if(rays>MAX_RAYS)throw this.inputs=before,new RangeError(
`the needle has changed its direction of cutting ${rays} times`);rays>this.rays&&(this.rays=2*rays,this.memory=
layOut(heap,this.memory.end,this,this.memory),[fault,stops,points,rays]=advance()),check(fault);let shape=stops?
readShape(heap,this.memory.shapes,points):this.shape;if(this.failed=shape.status!==STATUS[0],this.failed)return this.
inputs=before,shape;let{state,next}=this.memory;return Object.assign(this.memory,{state:next,next:state}),Object.
assign(this,{depth,shape}),shape}#count({bevel,...held}){return[bevel,held].map(value=>{let key=JSON.stringify(
value,(name,part2)=>name==="name"?null:part2);return this.numbers.has(key)||this.numbers.set(key,this.known.push(
value)),this.numbers.get(key)})}#recall([bevel,held]){return{bevel:this.known[bevel-1],...this.known[held-1]}}#listRays(){
let{heap,memory:{problem,fixed,state,scratch}}=this;return heap.borrow(()=>{let[cut,position]=[MOVE_BYTES*this.
rays,POSITION_BYTES].map(bytes=>heap.take(bytes)),count2=Number(heap.call.nf_session_rays(problem.at,fixed,state,
scratch,cut,position));return{rays:Array.from({length:count2},(_,n)=>({start:heap.floats(cut+MOVE_BYTES*n,1)[0],
numbers:Array.from(heap.integers(cut+MOVE_BYTES*n+8,2),Number)})),changed:heap.integers(position+POSITION_BYTES-
8,1)[0]!==0n}})}save(){let{model,inputs,planes,depth,shape,rays,heap,memory}=this,state=new Uint8Array(heap.memory.
buffer,memory.state,memory.bytes).slice();return{model,inputs,planes,depth,shape,rays,state}}restore({state,...saved}){
this.#layOut(saved),this.heap.put(state,this.memory.state)}path(){let{firstCell,spacing}=this.model,{rays,changed}=this.#listRays(),
alike=(one,other)=>one.every((number3,i)=>number3===other[i]),flip2=({depth,inputs})=>({depth,inputs:{...inputs,
bevel:{...inputs.bevel,side:-inputs.bevel.side}}}),isPoint=depth=>{let cell=depth<=SAME_DEPTH?0:1+Math.max(0,Math.
ceil((depth-firstCell-SAME_DEPTH)/spacing));return Math.abs((cell&&firstCell+(cell-1)*spacing)-depth)<=SAME_DEPTH},
steps2=[];rays.forEach(({start:start2,numbers},n)=>{let again=n>0&&alike(rays[n-1].numbers,numbers);again&&isPoint(
start2)?steps2.pop():again&&steps2.push(flip2(steps2[steps2.length-1])),steps2.push({depth:rays[n+1]?.start??this.
depth,inputs:this.#recall(numbers)})});let last4={depth:this.depth,inputs:this.inputs};return!rays.length||!alike(
rays[rays.length-1].numbers,this.#count(this.inputs))?steps2.push(last4):changed&&steps2.push(flip2(last4),last4),
steps2}again(model,steps2){return this.#begin(model,steps2[0].inputs),steps2.every(({depth,inputs})=>(this.go(
depth,inputs),!this.failed))}positions(s2){let{heap,shape:{x:x2,u,slope:slope4,planes,depth}}=this,at=Float64Array.
from(s2);if(!at.every(one=>one>=x2[0]&&one<=depth))throw new RangeError("s lies beyond the needle");return heap.
borrow(()=>{let out=heap.take(8*(1+planes)*at.length),memory=heap.take(8*(1+5*planes)*(x2.length+2)*Number(heap.
call.nf_lanes())),counts=[planes,1,x2.length,at.length].map(BigInt);return heap.call.nf_positions(...counts,...[
x2,u,slope4,at].map(array3=>heap.put(array3)),memory,out),heap.floats(out,(1+planes)*at.length).slice()})}load(s2){
let{heap,memory:{problem},shape:{planes,x:x2,u,slope:slope4,constraints}}=this;return heap.borrow(()=>{let cells=constraints.
length/(1+planes)-1,needle=heap.structure([x2.length,cells],[],[x2,u,slope4,constraints].map(array3=>heap.put(
array3))),memory=heap.take(heap.call.nf_memory(problem.at,1n)),out=heap.take(8*planes*s2.length);return heap.call.
nf_load(problem.at,needle,BigInt(s2.length),heap.put(Float64Array.from(s2)),memory,out),heap.floats(out,planes*
s2.length).slice()})}}}});function computeBand(session,draws,steps2){let{depth}=steps2[steps2.length-1];if(!(depth>0))return null;let s2=Array.
from({length:POINTS},(_,k2)=>k2===POINTS-1?depth:depth*k2/(POINTS-1)),needles=[],{y:y2,slope:slope4}=steps2[0].
inputs.base;for(let n=0;n<draws.sets;n+=1){let part2=values=>values.slice(n*values.length/draws.sets,(n+1)*values.
length/draws.sets),gain=draws.gain?.[n]??1,path2=steps2.map(({depth:depth2,inputs:{bevel,base,...held}})=>({depth:depth2,
inputs:{...held,bevel:{...bevel,strength:draws.strength[n]},base:{...base,y:y2+gain*(base.y-y2),slope:slope4+gain*
(base.slope-slope4)}}}));session.again({...session.model,mu:part2(draws.mu),law:part2(draws.law)},path2)&&needles.
push(session.positions(s2))}if(!needles.length)return null;let{planes}=session,along=axis=>Array.from({length:POINTS},
(_,k2)=>Float64Array.from(needles,points=>points[(1+planes)*k2+axis])),[across,z=null]=spanBands(planes>1?[along(
1),along(2)]:[along(1)]);return{x:along(0).map(values=>quantile(values.sort(),MIDDLE)),...across,z,failed:draws.
sets-needles.length}}function spanBands(planes){let sizes=new Float64Array(planes[0][0].length),scaled=planes.
map(heights2=>heights2.map(values=>{let sorted=values.slice().sort(),[low,middle,high]=[LOW,MIDDLE,HIGH].map(share=>quantile(
sorted,share));return values.forEach((value,i)=>{let scale=value<middle?middle-low:high-middle;scale>TINY&&(sizes[i]=
Math.max(sizes[i],Math.abs(value-middle)/scale))}),[middle,middle-low,high-middle]})),size2=sizes.sort()[Math.
min(Math.floor(LEVEL*sizes.length),sizes.length-1)];return scaled.map(points=>({low:points.map(([middle,below])=>middle-
size2*below),high:points.map(([middle,,above])=>middle+size2*above)}))}function quantile(sorted,share){let place=share*
(sorted.length-1),below=Math.floor(place);return sorted[below]+(place-below)*((sorted[below+1]??sorted[below])-
sorted[below])}var POINTS,LOW,MIDDLE,HIGH,LEVEL,TINY,init_band=__esm({"needlefit/viewer/page/model/band.js"(){
"use strict";init_needle();POINTS=51,[LOW,MIDDLE,HIGH]=[.025,.5,.975],LEVEL=.95,TINY=1e-9}});var band_worker_exports={};var newest,busy,init_band_worker=__esm({"needlefit/viewer/page/model/band_worker.js"(){
"use strict";init_needle();init_band();newest={},busy=!1;onmessage=async({data})=>{if(newest={...newest,...data},
!busy){busy=!0;for(let order=null;order!==newest;){order=newest;let{kernel,model,draws,steps:steps2,id}=order;
draws&&steps2&&postMessage({id,band:computeBand(await Session.begin(kernel,model,steps2[0].inputs),draws,steps2)}),
await new Promise(resume=>setTimeout(resume))}busy=!1}}}});function computeErrors(session,measured){let{depth}=session.shape,upto=Math.min(depth,measured.depth_mm);if(upto<
1)return null;let beyond=depth-measured.depth_mm,whole=Math.abs(beyond)<=1e-6,[simulated,other]=[[],[]];if(whole)
[simulated,other]=readTarget(session,measured.target,beyond);else if(measured.target.pose!=="free"&&measured.x.
length>1){let s2=Array.from({length:101},(_,i)=>upto*i/100);other=interpolate(measured,s2),simulated=ALIGN[measured.
target.pose](readPoints(session,s2),other)}else return null;let axes=AXES[measured.compared],distances=simulated.
map((point2,i)=>Math.hypot(...axes.map(axis=>point2[axis]-other[i][axis]))),deflection=Math.hypot(...axes.slice(
1).map(axis=>other[other.length-1][axis]-other[0][axis])),finite=Object.entries(METRICS).map(([name,compute])=>[
name,compute(distances,deflection)]).map(([name,value])=>[name,Number.isFinite(value)?value:null]);return{...Object.
fromEntries(finite),upto_mm:upto,whole,floor_mm:measured.floor_mm}}function readTarget(session,{s:s2,x:x2,y:y2,
z,pose},beyond=0){let measured=x2.map((one,i)=>[one,y2[i],z[i]]),points=readPoints(session,s2.map(one=>one+beyond)),
compared=s2.length>TIP_POINTS?points:[measured[0],[x2[1],...points[1].slice(1)]];return[ALIGN[pose](compared,measured),
measured]}function readPoints(session,s2){let{x:x2,depth,planes}=session.shape,points=session.positions(s2.map(
one=>Math.min(Math.max(one,x2[0]),depth)));return s2.map((_,i)=>[points[(1+planes)*i],points[(1+planes)*i+1],planes===
1?0:points[3*i+2]])}function interpolate({s:s2,x:x2,y:y2,z},at){let i=0;return at.map(one=>{for(;i<s2.length-2&&
s2[i+1]<one;)i+=1;let share=Math.min(Math.max((one-s2[i])/(s2[i+1]-s2[i]),0),1);return[x2,y2,z??[]].map(axis=>axis[i]+
share*(axis[i+1]-axis[i]))})}function shiftAcross(moving,fixed){let[dy,dz]=[1,2].map(axis=>mean(moving.map((point2,i)=>fixed[i][axis]-
point2[axis])));return moving.map(([x2,y2,z])=>[x2,y2+dy,z+dz])}function alignRigid(moving,fixed){let centre=points=>[
0,1].map(axis=>mean(points.map(one=>one[axis]))),[m,f]=[centre(moving),centre(fixed)],[across,along]=[0,0];moving.
forEach(([x2,y2],i)=>{let[a2,b,c2,d]=[x2-m[0],y2-m[1],fixed[i][0]-f[0],fixed[i][1]-f[1]];across+=a2*d-b*c2,along+=
a2*c2+b*d});let angle2=Math.atan2(across,along),[c,s2]=[Math.cos(angle2),Math.sin(angle2)];return moving.map(([
x2,y2,z])=>[c*(x2-m[0])-s2*(y2-m[1])+f[0],s2*(x2-m[0])+c*(y2-m[1])+f[1],z])}var mean,METRICS,AXES,TIP_POINTS,ALIGN,
init_errors=__esm({"needlefit/viewer/page/model/errors.js"(){"use strict";mean=values=>values.reduce((sum,one)=>sum+
one,0)/values.length,METRICS={ipe_mean_mm:mean,te_mm:d=>d[d.length-1],edp_percent:(d,deflection)=>100*d[d.length-
1]/deflection},AXES={plane:[0,1],space:[0,1,2]};TIP_POINTS=2;ALIGN={known:simulated=>simulated,direction:shiftAcross,
free:alignRigid}}});function checkChange([name,item,value],rules){let known=rules.inputs[name];if(!known)throw new ModelError(`the\
re is no input ${name}`,`one of ${Object.keys(rules.inputs).join(", ")}`);let counted2=item!==null&&Number.isInteger(
item)&&item>=1&&item<=(known.item==="guide"?rules.max_guide:1/0);if(known.item?!counted2:item!==null)throw new ModelError(
`${name} has item ${item}`,`the number of a ${known.item}`);let lengths=name.endsWith("_mm"),most=lengths?rules.
max_mm:rules.max,finite=Math.abs(value)<=most,{least:least2=-1/0,above=-1/0,upto=1/0,below=1/0,values}=known;if(!(finite&&
value>=least2&&value>above&&value<=upto&&value<below&&(!values||values.includes(value)))){let expected=finite||
known.expected&&!lengths?String(known.expected):`a finite number, at most ${most}${lengths?" mm":""}`;throw new ModelError(
`${nameOf(name)}${item===null?"":` of ${known.item} ${item}`} is ${written(name,value)}`,expected)}}function written(name,value){
if(name==="mu_pa")return Math.abs(value)<1e6?`${significant(value*.001)} kPa`:`${significant(value*1e-6)} MPa`;
if(name.endsWith("slope"))return`${(Math.atan(value)*DEGREES).toFixed(1)}°`;let[,unit]=UNITS.find(([end])=>name.
endsWith(end))??["",""];return`${significant(value)}${unit}`}function guideNumber(name,names){let at=names.indexOf(
name);return at<0?Number(name.replace("guide ","")):at+1}function applyChanges(step,changes,names,stands){let values=new Map(
changes.filter(([,item])=>item===null).map(([name,,value])=>[name,value])),of=(name,now2)=>values.get(name)??now2,
held=step.controls,{tip}=held;if(of("tip_held",1)===0)tip=null;else if(tip||values.has("tip_held")||values.has(
"tip_y_mm")){let[y2,z]=tip?[tip.y,tip.z??0]:stands;tip={y:of("tip_y_mm",y2),slope:of("tip_slope",tip?tip.slope:
null),z}}let[angle2,side]=[of("cut_angle_deg",null),of("bevel_side",null)],roll2=rollOf(side===null?step.bevel:
{side,roll:0});return{depth:of("depth_mm",step.depth),bevel:{...toSide(of("bevel_roll_deg",roll2)),offset:of("\
bevel_offset_mm",step.bevel.offset),cutAngle:angle2===null?step.bevel.cutAngle:angle2*RADIANS},controls:{baseY:of(
"base_y_mm",held.baseY),baseSlope:of("base_slope",held.baseSlope),stageSlope:held.stageSlope,guides:applyToGuides(
held.guides,changes,names),tip}}}function applyToGuides(guides,changes,names){let moves=new Map;for(let[name,item,
value]of changes)item===null||!name.startsWith("guide_")||moves.set(item,{...moves.get(item),[name.slice(6)]:value});
if(!moves.size)return guides;let now2=new Map(guides.map(guide=>[guide.name,guide]));for(let[item,moved]of[...moves].
sort(([one],[other])=>one-other)){let name=names[item-1]??`guide ${item}`;if(moved.engaged===0){now2.delete(name);
continue}let guide={slope:0,x:moved.x_mm,y:moved.y_mm,...now2.get(name)};if(guide.x===void 0||guide.y===void 0)
throw new ModelError(`there is no ${name}`,"guide_x_mm and guide_y_mm together, which make a guide");let slope4=moved.
slope??guide.slope;moved.turns_freely!==void 0&&(slope4=moved.turns_freely?null:moved.slope??guide.slope??0),now2.
set(name,{name,x:moved.x_mm??guide.x,y:moved.y_mm??guide.y,slope:slope4})}let ordered=[...now2.values()].sort(
(one,other)=>one.x-other.x),twice=ordered.find((guide,i)=>guide.x===ordered[i+1]?.x);if(twice)throw new ModelError(
`two guides stand at the same x = ${twice.x} mm`,"guides at different x");return ordered}function toInputs({bevel,
controls},pathAngle){if((pathAngle?bevel.offset:bevel.cutAngle)!==0)throw new ModelError("the strength of the \
bevel is that of the other rule of advance",pathAngle?"a cut angle alone":"an offset alone");let{baseY,baseSlope,
stageSlope,guides,tip}=controls;return{bevel:{side:bevel.side,roll:bevel.roll,strength:pathAngle?bevel.cutAngle:
bevel.offset},base:{y:baseY,slope:baseSlope,stageSlope},guides,tip:tip&&{y:tip.y,slope:tip.slope,z:tip.z??0}}}
function toStep({depth,inputs},pathAngle){let{bevel,base,guides,tip}=inputs,[offset,cutAngle]=pathAngle?[0,bevel.
strength]:[bevel.strength,0];return{depth,bevel:{side:bevel.side,roll:bevel.roll,offset,cutAngle},controls:{baseY:base.
y,baseSlope:base.slope,stageSlope:base.stageSlope,guides,tip}}}var ModelError,RADIANS,DEGREES,UNITS,nameOf,significant,
rollOf,toSide,wrap,turnOver,init_inputs=__esm({"needlefit/viewer/page/model/inputs.js"(){"use strict";ModelError=
class extends Error{constructor(what,expected){super(what),this.what=what,this.expected=expected}},RADIANS=Math.
PI/180,DEGREES=180/Math.PI,UNITS=[["_mm"," mm"],["_deg","°"],["_pa"," Pa"]];nameOf=name=>name.replace(/_(mm|deg|pa)$/,
"").replaceAll("_"," ");significant=value=>Number(value.toPrecision(6));rollOf=({side,roll:roll2})=>roll2+(side>
0?0:180),toSide=roll2=>Math.abs(roll2%360)===180?{side:-1,roll:roll2-180}:{side:1,roll:roll2},wrap=roll2=>180-
((180-roll2)%360+360)%360,turnOver=roll2=>roll2%180?["bevel_roll_deg",null,wrap(roll2+180)]:["bevel_side",null,
roll2%360?1:-1]}});function makeLaw({terms,tables},shape){if(!terms)return tables.find(([known])=>JSON.stringify(known)===JSON.stringify(
shape))?.[1]??null;let layers=shape[0]?.length??terms.layers;return Array.from({length:layers},(_,layer)=>terms.
at_zero.map((value,j)=>{let by=terms.slopes.findIndex(row=>row[j]);return by<0?value:value+shape[by][layer]*terms.
slopes[by][j]})).flat()}var BEARABLE,SteeredNeedle,init_steered=__esm({"needlefit/viewer/page/model/steered.js"(){
"use strict";init_needle();init_inputs();BEARABLE="a load that tissue and needle can bear";SteeredNeedle=class _SteeredNeedle{static async begin(kernel,scene){
let{model,steps:steps2}=scene.simulation;return new _SteeredNeedle(scene,await Session.begin(kernel,model,toInputs(
steps2[0],model.pathAngle)))}way=null;number=0;saved=new Map;constructor(scene,session){let{shape,steps:steps2,
rules}=scene.simulation;this.scene=scene,this.session=session,this.rules=rules,this.shape=shape,this.names=scene.
guide_names,this.step={...steps2[0],depth:0},this.keep()}get model(){return this.session.model}reach(controls=this.
step.controls){let[first]=controls.guides;return this.model.length+(first&&first.x<0?first.x-this.rules.clearance_mm:
0)-1e-6}get tipLateral(){return this.session.positions([this.session.shape.depth])[1]}path(){return this.session.
path().map(reached=>toStep(reached,this.model.pathAngle))}listWay(){let ways=[];for(let way=this.way;way;way=way.
before)ways.push(way);return ways.reverse()}keep(){let{step,shape,way}=this;this.saved.has(this.number)||this.
saved.set(this.number,{step,shape,way,session:this.session.save()})}forget(number3){number3&&this.saved.delete(
number3)}rewind(){let[[,first]]=this.saved;this.#return(first),Object.assign(this,{number:0,saved:new Map([[0,
first]])})}#return({session,...saved}){this.session.restore(session),Object.assign(this,saved)}shapeAfter(changes){
let shape=this.shape.map(row=>[...row]);for(let[name,item,value]of changes){let row=this.scene.shape_parameters.
findIndex(one=>one.name===name);row>=0&&item&&(shape[row][item-1]=value)}return shape}apply(changes){for(let[i,
change2]of changes.entries()){checkChange(change2,this.rules);let[name,item]=change2;if(changes.slice(0,i).some(
([one,other])=>one===name&&other===item))throw new ModelError(`${name} has two values in one step`,"one value \
for each input");if(name==="return_to"&&changes.length>1)throw new ModelError("return_to stands beside other i\
nputs","a step of its own")}if(changes[0]?.[0]==="return_to"){let saved=this.saved.get(changes[0][2]);if(!saved)
throw new ModelError(`nothing was kept of step ${changes[0][2]}`,"a step to return to");this.#return(saved)}else
this.#advance(changes),this.way={changes,tip:this.tipLateral,before:this.way};this.number+=1}#advance(changes){
let parameters=changes.filter(([name])=>this.rules.inputs[name].parameter),others=changes.filter(([name])=>!this.
rules.inputs[name].parameter);if(!parameters.length)return this.#move(others);let{step,shape}=this,before={step,
shape,session:this.session.save()};try{this.#simulateAgain(parameters),this.#move(others)}catch(error){throw this.#return(
before),error}}#simulateAgain(parameters){let mu=[...this.model.mu],[offset,angle2]=[null,null];for(let[name,item,
value]of parameters){if(item&&item>mu.length)throw new ModelError(`there is no layer ${item}`,`one of ${mu.length}\
 layers`);if(name==="mu_pa")mu[Number(item)-1]=value*1e-6;else if(name==="offset_throughout_mm")offset=value;else if(name===
"cut_angle_throughout_deg")angle2=value*(Math.PI/180);else if(!this.scene.shape_parameters.some(one=>one.name===
name))throw new ModelError(`the tissue law has no ${name}`,"a parameter of the law")}let shape=this.shapeAfter(
parameters),law=JSON.stringify(shape)===JSON.stringify(this.shape)?this.model.law:makeLaw(this.scene.simulation.
law,shape);if(!law)throw new ModelError("the law has not been computed with these parameters","the program");let{
pathAngle}=this.model,steps2=this.path().map(({bevel,...one})=>({...one,bevel:{...bevel,offset:offset??bevel.offset,
cutAngle:angle2??bevel.cutAngle}}));if(!this.#guard(()=>this.session.again({...this.model,mu,law},steps2.map(one=>({
depth:one.depth,inputs:toInputs(one,pathAngle)})))))throw new ModelError(`with these parameters the insertion \
so far fails ${this.session.depth.toFixed(1)} mm deep`,BEARABLE);Object.assign(this,{shape,step:steps2[steps2.
length-1]})}#move(changes){let{session}=this,{x:x2,u,planes}=session.shape,step=applyChanges(this.step,changes,
this.names,[u[x2.length-1],planes>1?u[u.length-1]:0]);if(!changes.length)return;let shape=this.#guard(()=>session.
go(step.depth,toInputs(step,this.model.pathAngle)));if(session.failed)throw new ModelError(`the model finds no\
 needle there (${shape.status})`,BEARABLE);this.step=step}#guard(work){try{return work()}catch(error){throw error instanceof
RangeError?new ModelError(error.message,`a needle of ${this.model.length} mm, its base before guides and tissu\
e`):error}}}}});function signed(value,digits2){let size2=Math.abs(value).toFixed(digits2);return Number(size2)===0?size2:(value<
0?"−":"+")+size2}function modulusLike(one){let[unit,pascals]=one<1e6?["kPa",1e3]:["MPa",1e6];return{unit,write:(value,digits2=4)=>brief(
value/pascals,digits2),read:text=>Number(text)*pascals}}function modulus(value){let{unit,write:write2}=modulusLike(
value);return`${write2(value,3)} ${unit}`}function isSteered(state,scene){let{steps:steps2}=scene.simulation,{
bevel,controls}=steps2.find(({depth})=>depth>=state.depth_mm-1e-6)??steps2[steps2.length-1],{base,guides,tip}=state;
return isChanged(state,scene)||state.bevel.roll_deg!==wrap(rollOf(bevel))||tip.held!==!!controls.tip||base.input_y!==
controls.baseY||base.input_slope!==controls.baseSlope||guides.length!==controls.guides.length||guides.some(({x:x2,
y:y2},i)=>x2!==controls.guides[i].x||y2!==controls.guides[i].y)}var writeError,listErrors,brief,counted,toDegrees,
degrees,slope,shortName,OFFSET,ANGLE,strengthOf,describeRoll,near,isChanged,predictionOf,init_quantities=__esm(
{"needlefit/viewer/page/quantities.js"(){"use strict";init_inputs();writeError=(value,unit)=>value===null?"–":
unit==="%"?brief(value,3):value.toFixed(3),listErrors=(errors,{metrics})=>metrics.map(([name,label2,unit])=>`${label2}\
 ${writeError(errors[name],unit)} ${unit}`);brief=(value,digits2=4)=>String(Number(value.toPrecision(digits2))),
counted=(count2,one)=>`${count2} ${one}${count2===1?"":"s"}`;toDegrees=rotation=>rotation*180/Math.PI,degrees=
slope4=>Math.atan(slope4)*180/Math.PI,slope=angle2=>Math.tan(Math.min(Math.max(angle2,-90),90)*Math.PI/180),shortName=
({item,name})=>name&&name!==`guide ${item}`?name:String(item),OFFSET={symbol:"b",unit:"mm",digits:3,step:.005,
here:"bevel_offset_mm",throughout:"offset_throughout_mm"},ANGLE={symbol:"θ",unit:"°",digits:2,step:.1,here:"\
cut_angle_deg",throughout:"cut_angle_throughout_deg"},strengthOf=({offset_mm:offset,cut_angle_deg:angle2})=>angle2===
void 0?{...OFFSET,value:offset??0}:{...ANGLE,value:angle2},describeRoll=({roll_deg:roll2})=>roll2%180?`roll ${brief(
roll2).replace("-","−")}°`:roll2?"−y":"+y",near=(one,other)=>Math.abs(one-other)<=1e-9*Math.abs(other),isChanged=
({bevel,layers},{fitted})=>!near(strengthOf(bevel).value,strengthOf(fitted).value)||layers.some((layer,i)=>Object.
entries(fitted.layers[i]).some(([name,one])=>!near(layer[name],one))),predictionOf=(state,scene)=>Math.abs(state.
depth_mm-scene.depth_mm)<1e-6&&!isSteered(state,scene)?scene.measured?.prediction??null:null}});function listKeys({fitted,shape_parameters:shapes}){let{throughout,symbol}=strengthOf(fitted);return[symbol===
"b"?makeKey("b",throughout,null,1,1,({step})=>step.bevel.offset):makeKey("theta",throughout,null,1,Math.PI/180,
({step})=>step.bevel.cutAngle),...fitted.layers.flatMap((_,i)=>[makeKey(`mu${i+1}`,"mu_pa",i+1,1e3,.001,({model})=>model.
mu[i]),...shapes.map(({name},row)=>makeKey(`${name}${i+1}`,name,i+1,1,1,({shape})=>shape[row][i]))])]}async function writeAddress(kernel,steered,name=null){
let{scene,step}=steered,path2=steered.path(),rolls=path2.map(({bevel})=>wrap(rollOf(bevel))),values=new URLSearchParams(
name===null?{}:{needle:name});values.set("depth",String(step.depth)),values.set("roll",String(rolls.at(-1)));let turns=path2.
slice(0,-1).map(({depth},i)=>{let by=shorten(wrap(rolls[i+1]-rolls[i]));return by===180?depth:`${depth}:${by}`});
turns.length&&values.set("turn",turns.join(","));let{model,shape,steps:[first]}=scene.simulation;for(let{key,item,
toModel,read}of listKeys(scene)){let value=read(steered);(!item||value!==read({model,shape,step:first}))&&values.
set(key,String(shorten(value/toModel)))}let address=values.toString().replaceAll("%2C",",").replaceAll("%3A","\
:");return await leadsTo(kernel,address,steered)?address:null}async function leadsTo(kernel,address,steered){let other=await SteeredNeedle.
begin(kernel,steered.scene);try{for(let changes of readAddress(address,steered.scene))other.apply(changes)}catch(error){
if(!(error instanceof ModelError))throw error;return!1}let s2=Array.from({length:POINTS2},(_,i)=>steered.step.
depth*i/(POINTS2-1)),[reached,wanted]=[other,steered].map(({session})=>readPoints(session,s2));return reached.
every((point2,i)=>Math.hypot(...point2.map((value,axis)=>value-wanted[i][axis]))<SAME)}function readAddress(address,scene){
let values=new URLSearchParams(address),keys=listKeys(scene),known=["needle","depth","roll","turn",...keys.map(
({key})=>key)],number3=(key,text,low=-1/0)=>{let value=Number(text);if(text?.trim()&&Number.isFinite(value)&&value>=
low)return value;throw new ModelError(`the address has ${key}=${text}`,low<0?"a number":`a number, ${low} or a\
bove`)};for(let key of values.keys())if(!known.includes(key))throw new ModelError(`the address has ${key}`,known.
join(", "));let doubled=[...values.keys()].find(key=>values.getAll(key).length>1);if(doubled)throw new ModelError(
`the address has ${doubled} more than once`,"each key once");if(!values.has("depth")){if([...values.keys()].some(
key=>key!=="needle"))throw new ModelError("the address has no depth","depth=, in mm");return[]}let[first]=scene.
simulation.steps,depth=number3("depth",values.get("depth"),0),turns=(values.get("turn")??"").split(",").filter(
Boolean).map(text=>{let[at,by="180"]=text.split(":");return{at:number3("turn",at,0),by:number3("turn",by)}});if(!turns.
every(({at},i)=>at>0&&at>=(turns[i-1]?.at??0)&&at<=depth))throw new ModelError(`the address has turn=${values.
get("turn")}`,`increasing depths, up to ${depth} mm`);let roll2=values.has("roll")?number3("roll",values.get("\
roll")):rollOf(first.bevel),after=turns.toReversed().map(({by})=>{let end=roll2;return roll2=wrap(roll2-by),end}).
reverse(),inputs=keys.filter(({key})=>values.has(key)).map(({key,input,item,toInput})=>[input,item,toInput*number3(
key,values.get(key))]),lists=[[["return_to",null,0]],[["bevel_roll_deg",null,roll2],...inputs]];return turns.forEach(
({at},i)=>lists.push([["depth_mm",null,at]],[["bevel_roll_deg",null,after[i]]])),[...lists,[["depth_mm",null,depth]]]}
function writeRecording(head,steered){let rows=steered.listWay().flatMap(({changes,tip},i)=>changes.map(([name,
item,value],n)=>`${i+1},${(i/10).toFixed(4)},${name},${item??""},${value},${n===changes.length-1?tip:""}`));return`${head}${rows.
join(`
`)}
`}var POINTS2,SAME,DIGITS,makeKey,shorten,nameIn,init_address=__esm({"needlefit/viewer/page/address.js"(){"use\
 strict";init_errors();init_inputs();init_steered();init_quantities();POINTS2=21,SAME=1e-6,DIGITS=12,makeKey=(key,input,item,toInput,toModel,read)=>({
key,input,item,toInput,toModel,read});shorten=value=>Number(value.toPrecision(DIGITS));nameIn=address=>new URLSearchParams(
address).get("needle")}});function publish(kind,message){for(let hear2 of listeners[kind]??[])hear2(message)}function take(kind,message){
Object.assign(now,{[kind]:message}),publish(kind,message)}var now,listeners,listen,redraw,init_store=__esm({"n\
eedlefit/viewer/page/store.js"(){"use strict";now={replay:null,band:null,pinned:null,labels:[],avoided:[],shown:{
measured:!0,band:!0,plan:!0,pinned:!0,errors:!1,points:!1,path:!1,load:!1,inset:!1}};Object.assign(window,{needlefit:now});
listeners={},listen=(kind,hear2)=>(listeners[kind]??=[]).push(hear2);redraw=()=>publish("redraw")}});function computeBands(worker){let ordered="";worker.postMessage({kernel:now.data.kernel});let about=()=>({needle:now.
data.needles.indexOf(now.needle),step:now.state.step});function order(){if(!now.state||ordered===JSON.stringify(
about()))return;ordered=JSON.stringify(about());let{model}=now.steered,steps2=now.steered.path().map(step=>({depth:step.
depth,inputs:toInputs(step,model.pathAngle)}));worker.postMessage({id:about(),model,steps:steps2})}worker.onmessage=
({data:{id,band}})=>{id.needle===about().needle&&take("band",band&&{step:id.step,...band})},listen("scene",({draws})=>{
ordered="",worker.postMessage({draws,steps:null})}),listen("drawn",order)}var init_bands=__esm({"needlefit/vie\
wer/page/bands.js"(){"use strict";init_inputs();init_store()}});function write(id,text){let place=typeof id=="string"?part(id):id;place.textContent!==text&&(place.textContent=
text)}function element(tag,properties={},...contents){let made2=Object.assign(document.createElement(tag),properties);
return made2.append(...contents.flat()),made2}function hand(blob,name){let link=element("a",{href:URL.createObjectURL(
blob),download:name});link.click(),setTimeout(()=>URL.revokeObjectURL(link.href),1e4)}function colour(name,paper){
let both=getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).match(/#\w+/g)??[""];return both[dark.
matches&&!paper?both.length-1:0]}var part,press,entry,dark,onScheme,getContext,init_dom=__esm({"needlefit/view\
er/page/dom.js"(){"use strict";part=id=>document.getElementById(id);press=(id,act)=>(typeof id=="string"?part(
id):id).addEventListener("click",act),entry=(term,value)=>element("div",{},element("dt",{},term),element("dd",
{},value));dark=matchMedia("(prefers-color-scheme: dark)"),onScheme=act=>dark.addEventListener("change",act),getContext=
canvas2=>canvas2.getContext("2d",{alpha:!1})}});function ascending(a2,b){return a2==null||b==null?NaN:a2<b?-1:a2>b?1:a2>=b?0:NaN}function descending(a2,b){return a2==
null||b==null?NaN:b<a2?-1:b>a2?1:b>=a2?0:NaN}function bisector(f){let compare1,compare2,delta;f.length!==2?(compare1=
ascending,compare2=(d,x2)=>ascending(f(d),x2),delta=(d,x2)=>f(d)-x2):(compare1=f===ascending||f===descending?f:
zero,compare2=f,delta=f);function left(a2,x2,lo=0,hi=a2.length){if(lo<hi){if(compare1(x2,x2)!==0)return hi;do{
let mid=lo+hi>>>1;compare2(a2[mid],x2)<0?lo=mid+1:hi=mid}while(lo<hi)}return lo}function right(a2,x2,lo=0,hi=a2.
length){if(lo<hi){if(compare1(x2,x2)!==0)return hi;do{let mid=lo+hi>>>1;compare2(a2[mid],x2)<=0?lo=mid+1:hi=mid}while(lo<
hi)}return lo}function center(a2,x2,lo=0,hi=a2.length){let i=left(a2,x2,lo,hi-1);return i>lo&&delta(a2[i-1],x2)>
-delta(a2[i],x2)?i-1:i}return{left,center,right}}function zero(){return 0}function number(x2){return x2===null?
NaN:+x2}function Blur2(blur){return function(data,rx,ry=rx){if(!((rx=+rx)>=0))throw new RangeError("invalid rx");
if(!((ry=+ry)>=0))throw new RangeError("invalid ry");let{data:values,width,height}=data;if(!((width=Math.floor(
width))>=0))throw new RangeError("invalid width");if(!((height=Math.floor(height!==void 0?height:values.length/
width))>=0))throw new RangeError("invalid height");if(!width||!height||!rx&&!ry)return data;let blurx=rx&&blur(
rx),blury=ry&&blur(ry),temp=values.slice();return blurx&&blury?(blurh(blurx,temp,values,width,height),blurh(blurx,
values,temp,width,height),blurh(blurx,temp,values,width,height),blurv(blury,values,temp,width,height),blurv(blury,
temp,values,width,height),blurv(blury,values,temp,width,height)):blurx?(blurh(blurx,values,temp,width,height),
blurh(blurx,temp,values,width,height),blurh(blurx,values,temp,width,height)):blury&&(blurv(blury,values,temp,width,
height),blurv(blury,temp,values,width,height),blurv(blury,values,temp,width,height)),data}}function blurh(blur,T,S,w,h){
for(let y2=0,n=w*h;y2<n;)blur(T,S,y2,y2+=w,1)}function blurv(blur,T,S,w,h){for(let x2=0,n=w*h;x2<w;++x2)blur(T,
S,x2,x2+n,w)}function blurfImage(radius){let blur=blurf(radius);return(T,S,start2,stop,step)=>{start2<<=2,stop<<=
2,step<<=2,blur(T,S,start2+0,stop+0,step),blur(T,S,start2+1,stop+1,step),blur(T,S,start2+2,stop+2,step),blur(T,
S,start2+3,stop+3,step)}}function blurf(radius){let radius0=Math.floor(radius);if(radius0===radius)return bluri(
radius);let t=radius-radius0,w=2*radius+1;return(T,S,start2,stop,step)=>{if(!((stop-=step)>=start2))return;let sum=radius0*
S[start2],s0=step*radius0,s1=s0+step;for(let i=start2,j=start2+s0;i<j;i+=step)sum+=S[Math.min(stop,i)];for(let i=start2,
j=stop;i<=j;i+=step)sum+=S[Math.min(stop,i+s0)],T[i]=(sum+t*(S[Math.max(start2,i-s1)]+S[Math.min(stop,i+s1)]))/
w,sum-=S[Math.max(start2,i-s0)]}}function bluri(radius){let w=2*radius+1;return(T,S,start2,stop,step)=>{if(!((stop-=
step)>=start2))return;let sum=radius*S[start2],s2=step*radius;for(let i=start2,j=start2+s2;i<j;i+=step)sum+=S[Math.
min(stop,i)];for(let i=start2,j=stop;i<=j;i+=step)sum+=S[Math.min(stop,i+s2)],T[i]=sum/w,sum-=S[Math.max(start2,
i-s2)]}}function extent(values,valueof){let min,max2;if(valueof===void 0)for(let value of values)value!=null&&
(min===void 0?value>=value&&(min=max2=value):(min>value&&(min=value),max2<value&&(max2=value)));else{let index=-1;
for(let value of values)(value=valueof(value,++index,values))!=null&&(min===void 0?value>=value&&(min=max2=value):
(min>value&&(min=value),max2<value&&(max2=value)))}return[min,max2]}function tickSpec(start2,stop,count2){let step=(stop-
start2)/Math.max(0,count2),power=Math.floor(Math.log10(step)),error=step/Math.pow(10,power),factor=error>=e10?
10:error>=e5?5:error>=e2?2:1,i1,i2,inc;return power<0?(inc=Math.pow(10,-power)/factor,i1=Math.round(start2*inc),
i2=Math.round(stop*inc),i1/inc<start2&&++i1,i2/inc>stop&&--i2,inc=-inc):(inc=Math.pow(10,power)*factor,i1=Math.
round(start2/inc),i2=Math.round(stop/inc),i1*inc<start2&&++i1,i2*inc>stop&&--i2),i2<i1&&.5<=count2&&count2<2?tickSpec(
start2,stop,count2*2):[i1,i2,inc]}function ticks(start2,stop,count2){if(stop=+stop,start2=+start2,count2=+count2,
!(count2>0))return[];if(start2===stop)return[start2];let reverse=stop<start2,[i1,i2,inc]=reverse?tickSpec(stop,
start2,count2):tickSpec(start2,stop,count2);if(!(i2>=i1))return[];let n=i2-i1+1,ticks2=new Array(n);if(reverse)
if(inc<0)for(let i=0;i<n;++i)ticks2[i]=(i2-i)/-inc;else for(let i=0;i<n;++i)ticks2[i]=(i2-i)*inc;else if(inc<0)
for(let i=0;i<n;++i)ticks2[i]=(i1+i)/-inc;else for(let i=0;i<n;++i)ticks2[i]=(i1+i)*inc;return ticks2}function tickIncrement(start2,stop,count2){
return stop=+stop,start2=+start2,count2=+count2,tickSpec(start2,stop,count2)[2]}function nice(start2,stop,count2){
let prestep;for(;;){let step=tickIncrement(start2,stop,count2);if(step===prestep||step===0||!isFinite(step))return[
start2,stop];if(step>0){let i=Math.ceil(start2/step),j=Math.floor(stop/step);start2=(i-(i*step>start2))*step,stop=
(j+(j*step<stop))*step}else if(step<0){let s2=-step,i=Math.ceil(start2*s2),j=Math.floor(stop*s2);start2=(i-(i/
s2>start2))/s2,stop=(j+(j/s2<stop))/s2}prestep=step}}function max(values,valueof){let max2;if(valueof===void 0)
for(let value of values)value!=null&&(max2<value||max2===void 0&&value>=value)&&(max2=value);else{let index=-1;
for(let value of values)(value=valueof(value,++index,values))!=null&&(max2<value||max2===void 0&&value>=value)&&
(max2=value)}return max2}function range(start2,stop,step){start2=+start2,stop=+stop,step=(n=arguments.length)<
2?(stop=start2,start2=0,1):n<3?1:+step;for(var i=-1,n=Math.max(0,Math.ceil((stop-start2)/step))|0,range2=new Array(
n);++i<n;)range2[i]=start2+i*step;return range2}function least(values,compare=ascending){let min,defined=!1;if(compare.
length===1){let minValue;for(let element2 of values){let value=compare(element2);(defined?ascending(value,minValue)<
0:ascending(value,value)===0)&&(min=element2,minValue=value,defined=!0)}}else for(let value of values)(defined?
compare(value,min)<0:compare(value,value)===0)&&(min=value,defined=!0);return min}function shuffler(random){return function(array3,i0=0,i1=array3.
length){let m=i1-(i0=+i0);for(;m;){let i=random()*m--|0,t=array3[m+i0];array3[m+i0]=array3[i+i0],array3[i+i0]=
t}return array3}}var ascendingBisect,bisectRight,bisectLeft,bisectCenter,blur2,blurImage,array,slice,e10,e5,e2,
shuffle,init_d3_array=__esm({"node_modules/d3-array/dist/d3-array.mjs"(){ascendingBisect=bisector(ascending),bisectRight=
ascendingBisect.right,bisectLeft=ascendingBisect.left,bisectCenter=bisector(number).center,blur2=Blur2(blurf),
blurImage=Blur2(blurfImage);array=Array.prototype,slice=array.slice,e10=Math.sqrt(50),e5=Math.sqrt(10),e2=Math.
sqrt(2);shuffle=shuffler(Math.random)}});function look(window2,draw2){let kept={...view};Object.assign(view,window2);try{return draw2()}finally{Object.
assign(view,kept)}}function resize(width,height){view.box={left:GUTTER.left,top:GUTTER.top,width:Math.max(width-
GUTTER.left-GUTTER.right,10),height:Math.max(height-GUTTER.top-GUTTER.bottom,10)},fit(view.fit)}function fit(which){
if(view.fit=which,redraw(),!now.scene||!now.state||which==="moved")return;if(which==="tip"){let{x:x2,y:y2}=now.
state.tip;return Object.assign(view,{scale:view.box.width/TIP_WINDOW,magnified:1,x:x2,y:y2})}let[low,high,before,
after]=which==="whole"?[-now.scene.length_mm,deepest()+4,Math.min(74,.1*view.box.width+20),34]:[0,1.04*deepest(),
Math.min(44,.1*view.box.width),Math.min(84,.12*view.box.width)],room=view.box.width-before-after,[bottom,top]=heights(),
[along,across]=[room/(high-low),roomAcross()/(top-bottom)];view.scale=Math.min(along,across);let least2=LEAST_SPAN*
deepest(),times=roomAcross()/view.scale/Math.max(top-bottom,least2);view.magnified=MAGNIFICATIONS.filter(one=>one<=
times).at(-1)??1,view.x=(low+high)/2+(after-before)/(2*view.scale),view.y=(bottom+top)/2}function zoom(factor,[
px,py]=[toPx(view.x),toPy(view.y)]){let[x2,y2]=[fromPx(px),fromPy(py)];view.scale=Math.min(Math.max(view.scale*
factor,SCALES[0]),SCALES[1]),view.x+=x2-fromPx(px),view.y+=y2-fromPy(py),fit("moved")}function pan(px,py){view.
x-=px/view.scale,view.y+=py/(view.scale*view.magnified),fit("moved")}function deepest(){let{depth_mm:depth,boundaries_mm:tops,
measured}=now.scene,goals=goalCircles().map(([x2,,radius])=>x2+radius);return Math.max(depth,now.state.depth_mm,
(tops.at(-1)??0)+5,measured?.depth_mm??0,...goals)}function goalCircles(){let{plan}=now.scene;return plan?[[...plan.
target,plan.radius],...plan.obstacles.map(([x2,y2,radius])=>[x2,y2,radius])]:[]}function heights(){let{state,band,
pinned,scene:{measured}}=now,seen=[state,pinned].flatMap(one=>one?one.y.filter((_,i)=>view.fit==="whole"||one.
x[i]>=0):[]),goals=goalCircles().flatMap(([,y2,radius])=>[y2-radius,y2+radius]);return extent([...seen,...measured?.
y??[],...goals,...band?.low??[],...band?.high??[],0])}function seesTip(){let{left,top,width,height}=view.box,{
x:x2,y:y2}=now.state.tip,[px,py]=[toPx(x2)-left,toPy(y2)-top];return px>=0&&px<=width&&py>=0&&py<=height}function follow(){
let anew=view.of!==now.scene;if(view.of=now.scene,view.fit==="moved"&&!anew)return;if(anew||view.fit==="tip")return fit(
view.fit==="moved"?"tissue":view.fit);let[bottom,top]=heights(),px=view.scale*view.magnified,out=Math.max(top-
view.y,view.y-bottom)*px>roomAcross()/2+1||!seesTip(),low=(top-bottom)*px<LOW2*roomAcross();(out||low&&view.magnified<
MAGNIFICATIONS[MAGNIFICATIONS.length-1])&&fit(view.fit)}var GUTTER,MAGNIFICATIONS,ROOM,LEAST_SPAN,LOW2,TIP_WINDOW,
SCALES,view,toPx,toPy,fromPx,fromPy,roomAcross,init_view=__esm({"needlefit/viewer/page/view.js"(){"use strict";
init_d3_array();init_store();GUTTER={left:56,right:10,top:50,bottom:40},MAGNIFICATIONS=[1,1.5,2,3,4,5,6,8,10,12,
15,20,30,50],ROOM=56,LEAST_SPAN=.01,LOW2=.45,TIP_WINDOW=45,SCALES=[.5,400],view={x:0,y:0,scale:5,magnified:1,fit:"\
tissue",of:null,box:{left:0,top:0,width:1,height:1}};Object.assign(now,{view});toPx=x2=>view.box.left+view.box.
width/2+(x2-view.x)*view.scale,toPy=y2=>view.box.top+view.box.height/2-(y2-view.y)*view.scale*view.magnified,fromPx=
px=>view.x+(px-view.box.left-view.box.width/2)/view.scale,fromPy=py=>view.y-(py-view.box.top-view.box.height/2)/
(view.scale*view.magnified);roomAcross=()=>view.box.height-2*Math.min(ROOM,.2*view.box.height);listen("band",follow)}});function define(constructor,factory,prototype){constructor.prototype=factory.prototype=prototype,prototype.constructor=
constructor}function extend(parent,definition){var prototype=Object.create(parent.prototype);for(var key in definition)
prototype[key]=definition[key];return prototype}function Color(){}function color_formatHex(){return this.rgb().
formatHex()}function color_formatHex8(){return this.rgb().formatHex8()}function color_formatHsl(){return hslConvert(
this).formatHsl()}function color_formatRgb(){return this.rgb().formatRgb()}function color(format){var m,l;return format=
(format+"").trim().toLowerCase(),(m=reHex.exec(format))?(l=m[1].length,m=parseInt(m[1],16),l===6?rgbn(m):l===3?
new Rgb(m>>8&15|m>>4&240,m>>4&15|m&240,(m&15)<<4|m&15,1):l===8?rgba(m>>24&255,m>>16&255,m>>8&255,(m&255)/255):
l===4?rgba(m>>12&15|m>>8&240,m>>8&15|m>>4&240,m>>4&15|m&240,((m&15)<<4|m&15)/255):null):(m=reRgbInteger.exec(format))?
new Rgb(m[1],m[2],m[3],1):(m=reRgbPercent.exec(format))?new Rgb(m[1]*255/100,m[2]*255/100,m[3]*255/100,1):(m=reRgbaInteger.
exec(format))?rgba(m[1],m[2],m[3],m[4]):(m=reRgbaPercent.exec(format))?rgba(m[1]*255/100,m[2]*255/100,m[3]*255/
100,m[4]):(m=reHslPercent.exec(format))?hsla(m[1],m[2]/100,m[3]/100,1):(m=reHslaPercent.exec(format))?hsla(m[1],
m[2]/100,m[3]/100,m[4]):named.hasOwnProperty(format)?rgbn(named[format]):format==="transparent"?new Rgb(NaN,NaN,
NaN,0):null}function rgbn(n){return new Rgb(n>>16&255,n>>8&255,n&255,1)}function rgba(r,g,b,a2){return a2<=0&&
(r=g=b=NaN),new Rgb(r,g,b,a2)}function rgbConvert(o){return o instanceof Color||(o=color(o)),o?(o=o.rgb(),new Rgb(
o.r,o.g,o.b,o.opacity)):new Rgb}function rgb(r,g,b,opacity){return arguments.length===1?rgbConvert(r):new Rgb(
r,g,b,opacity??1)}function Rgb(r,g,b,opacity){this.r=+r,this.g=+g,this.b=+b,this.opacity=+opacity}function rgb_formatHex(){
return`#${hex(this.r)}${hex(this.g)}${hex(this.b)}`}function rgb_formatHex8(){return`#${hex(this.r)}${hex(this.
g)}${hex(this.b)}${hex((isNaN(this.opacity)?1:this.opacity)*255)}`}function rgb_formatRgb(){let a2=clampa(this.
opacity);return`${a2===1?"rgb(":"rgba("}${clampi(this.r)}, ${clampi(this.g)}, ${clampi(this.b)}${a2===1?")":`,\
 ${a2})`}`}function clampa(opacity){return isNaN(opacity)?1:Math.max(0,Math.min(1,opacity))}function clampi(value){
return Math.max(0,Math.min(255,Math.round(value)||0))}function hex(value){return value=clampi(value),(value<16?
"0":"")+value.toString(16)}function hsla(h,s2,l,a2){return a2<=0?h=s2=l=NaN:l<=0||l>=1?h=s2=NaN:s2<=0&&(h=NaN),
new Hsl(h,s2,l,a2)}function hslConvert(o){if(o instanceof Hsl)return new Hsl(o.h,o.s,o.l,o.opacity);if(o instanceof
Color||(o=color(o)),!o)return new Hsl;if(o instanceof Hsl)return o;o=o.rgb();var r=o.r/255,g=o.g/255,b=o.b/255,
min=Math.min(r,g,b),max2=Math.max(r,g,b),h=NaN,s2=max2-min,l=(max2+min)/2;return s2?(r===max2?h=(g-b)/s2+(g<b)*
6:g===max2?h=(b-r)/s2+2:h=(r-g)/s2+4,s2/=l<.5?max2+min:2-max2-min,h*=60):s2=l>0&&l<1?0:h,new Hsl(h,s2,l,o.opacity)}
function hsl(h,s2,l,opacity){return arguments.length===1?hslConvert(h):new Hsl(h,s2,l,opacity??1)}function Hsl(h,s2,l,opacity){
this.h=+h,this.s=+s2,this.l=+l,this.opacity=+opacity}function clamph(value){return value=(value||0)%360,value<
0?value+360:value}function clampt(value){return Math.max(0,Math.min(1,value||0))}function hsl2rgb(h,m1,m2){return(h<
60?m1+(m2-m1)*h/60:h<180?m2:h<240?m1+(m2-m1)*(240-h)/60:m1)*255}function labConvert(o){if(o instanceof Lab)return new Lab(
o.l,o.a,o.b,o.opacity);if(o instanceof Hcl)return hcl2lab(o);o instanceof Rgb||(o=rgbConvert(o));var r=rgb2lrgb(
o.r),g=rgb2lrgb(o.g),b=rgb2lrgb(o.b),y2=xyz2lab((.2225045*r+.7168786*g+.0606169*b)/Yn),x2,z;return r===g&&g===
b?x2=z=y2:(x2=xyz2lab((.4360747*r+.3850649*g+.1430804*b)/Xn),z=xyz2lab((.0139322*r+.0971045*g+.7141733*b)/Zn)),
new Lab(116*y2-16,500*(x2-y2),200*(y2-z),o.opacity)}function lab(l,a2,b,opacity){return arguments.length===1?labConvert(
l):new Lab(l,a2,b,opacity??1)}function Lab(l,a2,b,opacity){this.l=+l,this.a=+a2,this.b=+b,this.opacity=+opacity}
function xyz2lab(t){return t>t3?Math.pow(t,1/3):t/t2+t0}function lab2xyz(t){return t>t1?t*t*t:t2*(t-t0)}function lrgb2rgb(x2){
return 255*(x2<=.0031308?12.92*x2:1.055*Math.pow(x2,1/2.4)-.055)}function rgb2lrgb(x2){return(x2/=255)<=.04045?
x2/12.92:Math.pow((x2+.055)/1.055,2.4)}function hclConvert(o){if(o instanceof Hcl)return new Hcl(o.h,o.c,o.l,o.
opacity);if(o instanceof Lab||(o=labConvert(o)),o.a===0&&o.b===0)return new Hcl(NaN,0<o.l&&o.l<100?0:NaN,o.l,o.
opacity);var h=Math.atan2(o.b,o.a)*degrees2;return new Hcl(h<0?h+360:h,Math.sqrt(o.a*o.a+o.b*o.b),o.l,o.opacity)}
function hcl(h,c,l,opacity){return arguments.length===1?hclConvert(h):new Hcl(h,c,l,opacity??1)}function Hcl(h,c,l,opacity){
this.h=+h,this.c=+c,this.l=+l,this.opacity=+opacity}function hcl2lab(o){if(isNaN(o.h))return new Lab(o.l,0,0,o.
opacity);var h=o.h*radians;return new Lab(o.l,Math.cos(h)*o.c,Math.sin(h)*o.c,o.opacity)}function cubehelixConvert(o){
if(o instanceof Cubehelix)return new Cubehelix(o.h,o.s,o.l,o.opacity);o instanceof Rgb||(o=rgbConvert(o));var r=o.
r/255,g=o.g/255,b=o.b/255,l=(BC_DA*b+ED*r-EB*g)/(BC_DA+ED-EB),bl=b-l,k2=(E*(g-l)-C*bl)/D,s2=Math.sqrt(k2*k2+bl*
bl)/(E*l*(1-l)),h=s2?Math.atan2(k2,bl)*degrees2-120:NaN;return new Cubehelix(h<0?h+360:h,s2,l,o.opacity)}function cubehelix(h,s2,l,opacity){
return arguments.length===1?cubehelixConvert(h):new Cubehelix(h,s2,l,opacity??1)}function Cubehelix(h,s2,l,opacity){
this.h=+h,this.s=+s2,this.l=+l,this.opacity=+opacity}var darker,brighter,reI,reN,reP,reHex,reRgbInteger,reRgbPercent,
reRgbaInteger,reRgbaPercent,reHslPercent,reHslaPercent,named,radians,degrees2,K,Xn,Yn,Zn,t0,t1,t2,t3,A,B,C,D,E,
ED,EB,BC_DA,init_d3_color=__esm({"node_modules/d3-color/dist/d3-color.mjs"(){darker=.7,brighter=1/darker,reI="\
\\s*([+-]?\\d+)\\s*",reN="\\s*([+-]?(?:\\d*\\.)?\\d+(?:[eE][+-]?\\d+)?)\\s*",reP="\\s*([+-]?(?:\\d*\\.)?\\d+(?:[eE\
][+-]?\\d+)?)%\\s*",reHex=/^#([0-9a-f]{3,8})$/,reRgbInteger=new RegExp(`^rgb\\(${reI},${reI},${reI}\\)$`),reRgbPercent=
new RegExp(`^rgb\\(${reP},${reP},${reP}\\)$`),reRgbaInteger=new RegExp(`^rgba\\(${reI},${reI},${reI},${reN}\\)$`),
reRgbaPercent=new RegExp(`^rgba\\(${reP},${reP},${reP},${reN}\\)$`),reHslPercent=new RegExp(`^hsl\\(${reN},${reP}\
,${reP}\\)$`),reHslaPercent=new RegExp(`^hsla\\(${reN},${reP},${reP},${reN}\\)$`),named={aliceblue:15792383,antiquewhite:16444375,
aqua:65535,aquamarine:8388564,azure:15794175,beige:16119260,bisque:16770244,black:0,blanchedalmond:16772045,blue:255,
blueviolet:9055202,brown:10824234,burlywood:14596231,cadetblue:6266528,chartreuse:8388352,chocolate:13789470,coral:16744272,
cornflowerblue:6591981,cornsilk:16775388,crimson:14423100,cyan:65535,darkblue:139,darkcyan:35723,darkgoldenrod:12092939,
darkgray:11119017,darkgreen:25600,darkgrey:11119017,darkkhaki:12433259,darkmagenta:9109643,darkolivegreen:5597999,
darkorange:16747520,darkorchid:10040012,darkred:9109504,darksalmon:15308410,darkseagreen:9419919,darkslateblue:4734347,
darkslategray:3100495,darkslategrey:3100495,darkturquoise:52945,darkviolet:9699539,deeppink:16716947,deepskyblue:49151,
dimgray:6908265,dimgrey:6908265,dodgerblue:2003199,firebrick:11674146,floralwhite:16775920,forestgreen:2263842,
fuchsia:16711935,gainsboro:14474460,ghostwhite:16316671,gold:16766720,goldenrod:14329120,gray:8421504,green:32768,
greenyellow:11403055,grey:8421504,honeydew:15794160,hotpink:16738740,indianred:13458524,indigo:4915330,ivory:16777200,
khaki:15787660,lavender:15132410,lavenderblush:16773365,lawngreen:8190976,lemonchiffon:16775885,lightblue:11393254,
lightcoral:15761536,lightcyan:14745599,lightgoldenrodyellow:16448210,lightgray:13882323,lightgreen:9498256,lightgrey:13882323,
lightpink:16758465,lightsalmon:16752762,lightseagreen:2142890,lightskyblue:8900346,lightslategray:7833753,lightslategrey:7833753,
lightsteelblue:11584734,lightyellow:16777184,lime:65280,limegreen:3329330,linen:16445670,magenta:16711935,maroon:8388608,
mediumaquamarine:6737322,mediumblue:205,mediumorchid:12211667,mediumpurple:9662683,mediumseagreen:3978097,mediumslateblue:8087790,
mediumspringgreen:64154,mediumturquoise:4772300,mediumvioletred:13047173,midnightblue:1644912,mintcream:16121850,
mistyrose:16770273,moccasin:16770229,navajowhite:16768685,navy:128,oldlace:16643558,olive:8421376,olivedrab:7048739,
orange:16753920,orangered:16729344,orchid:14315734,palegoldenrod:15657130,palegreen:10025880,paleturquoise:11529966,
palevioletred:14381203,papayawhip:16773077,peachpuff:16767673,peru:13468991,pink:16761035,plum:14524637,powderblue:11591910,
purple:8388736,rebeccapurple:6697881,red:16711680,rosybrown:12357519,royalblue:4286945,saddlebrown:9127187,salmon:16416882,
sandybrown:16032864,seagreen:3050327,seashell:16774638,sienna:10506797,silver:12632256,skyblue:8900331,slateblue:6970061,
slategray:7372944,slategrey:7372944,snow:16775930,springgreen:65407,steelblue:4620980,tan:13808780,teal:32896,
thistle:14204888,tomato:16737095,turquoise:4251856,violet:15631086,wheat:16113331,white:16777215,whitesmoke:16119285,
yellow:16776960,yellowgreen:10145074};define(Color,color,{copy(channels){return Object.assign(new this.constructor,
this,channels)},displayable(){return this.rgb().displayable()},hex:color_formatHex,formatHex:color_formatHex,formatHex8:color_formatHex8,
formatHsl:color_formatHsl,formatRgb:color_formatRgb,toString:color_formatRgb});define(Rgb,rgb,extend(Color,{brighter(k2){
return k2=k2==null?brighter:Math.pow(brighter,k2),new Rgb(this.r*k2,this.g*k2,this.b*k2,this.opacity)},darker(k2){
return k2=k2==null?darker:Math.pow(darker,k2),new Rgb(this.r*k2,this.g*k2,this.b*k2,this.opacity)},rgb(){return this},
clamp(){return new Rgb(clampi(this.r),clampi(this.g),clampi(this.b),clampa(this.opacity))},displayable(){return-.5<=
this.r&&this.r<255.5&&-.5<=this.g&&this.g<255.5&&-.5<=this.b&&this.b<255.5&&0<=this.opacity&&this.opacity<=1},
hex:rgb_formatHex,formatHex:rgb_formatHex,formatHex8:rgb_formatHex8,formatRgb:rgb_formatRgb,toString:rgb_formatRgb}));
define(Hsl,hsl,extend(Color,{brighter(k2){return k2=k2==null?brighter:Math.pow(brighter,k2),new Hsl(this.h,this.
s,this.l*k2,this.opacity)},darker(k2){return k2=k2==null?darker:Math.pow(darker,k2),new Hsl(this.h,this.s,this.
l*k2,this.opacity)},rgb(){var h=this.h%360+(this.h<0)*360,s2=isNaN(h)||isNaN(this.s)?0:this.s,l=this.l,m2=l+(l<
.5?l:1-l)*s2,m1=2*l-m2;return new Rgb(hsl2rgb(h>=240?h-240:h+120,m1,m2),hsl2rgb(h,m1,m2),hsl2rgb(h<120?h+240:h-
120,m1,m2),this.opacity)},clamp(){return new Hsl(clamph(this.h),clampt(this.s),clampt(this.l),clampa(this.opacity))},
displayable(){return(0<=this.s&&this.s<=1||isNaN(this.s))&&0<=this.l&&this.l<=1&&0<=this.opacity&&this.opacity<=
1},formatHsl(){let a2=clampa(this.opacity);return`${a2===1?"hsl(":"hsla("}${clamph(this.h)}, ${clampt(this.s)*
100}%, ${clampt(this.l)*100}%${a2===1?")":`, ${a2})`}`}}));radians=Math.PI/180,degrees2=180/Math.PI,K=18,Xn=.96422,
Yn=1,Zn=.82521,t0=4/29,t1=6/29,t2=3*t1*t1,t3=t1*t1*t1;define(Lab,lab,extend(Color,{brighter(k2){return new Lab(
this.l+K*(k2??1),this.a,this.b,this.opacity)},darker(k2){return new Lab(this.l-K*(k2??1),this.a,this.b,this.opacity)},
rgb(){var y2=(this.l+16)/116,x2=isNaN(this.a)?y2:y2+this.a/500,z=isNaN(this.b)?y2:y2-this.b/200;return x2=Xn*lab2xyz(
x2),y2=Yn*lab2xyz(y2),z=Zn*lab2xyz(z),new Rgb(lrgb2rgb(3.1338561*x2-1.6168667*y2-.4906146*z),lrgb2rgb(-.9787684*
x2+1.9161415*y2+.033454*z),lrgb2rgb(.0719453*x2-.2289914*y2+1.4052427*z),this.opacity)}}));define(Hcl,hcl,extend(
Color,{brighter(k2){return new Hcl(this.h,this.c,this.l+K*(k2??1),this.opacity)},darker(k2){return new Hcl(this.
h,this.c,this.l-K*(k2??1),this.opacity)},rgb(){return hcl2lab(this).rgb()}}));A=-.14861,B=1.78277,C=-.29227,D=
-.90649,E=1.97294,ED=E*D,EB=E*B,BC_DA=B*C-D*A;define(Cubehelix,cubehelix,extend(Color,{brighter(k2){return k2=
k2==null?brighter:Math.pow(brighter,k2),new Cubehelix(this.h,this.s,this.l*k2,this.opacity)},darker(k2){return k2=
k2==null?darker:Math.pow(darker,k2),new Cubehelix(this.h,this.s,this.l*k2,this.opacity)},rgb(){var h=isNaN(this.
h)?0:(this.h+120)*radians,l=+this.l,a2=isNaN(this.s)?0:this.s*l*(1-l),cosh2=Math.cos(h),sinh2=Math.sin(h);return new Rgb(
255*(l+a2*(A*cosh2+B*sinh2)),255*(l+a2*(C*cosh2+D*sinh2)),255*(l+a2*(E*cosh2)),this.opacity)}}))}});function append(strings){this._+=strings[0];for(let i=1,n=strings.length;i<n;++i)this._+=arguments[i]+strings[i]}
function appendRound(digits2){let d=Math.floor(digits2);if(!(d>=0))throw new Error(`invalid digits: ${digits2}`);
if(d>15)return append;let k2=10**d;return function(strings){this._+=strings[0];for(let i=1,n=strings.length;i<
n;++i)this._+=Math.round(arguments[i]*k2)/k2+strings[i]}}function equal(x0,y0,x1,y1){return x0===x1&&y0===y1}function equalRound(digits2){
let d=Math.floor(digits2);if(!(d<=15))return equal;let k2=10**d,r=function(value){return Math.round(value*k2)};
return function(x0,y0,x1,y1){return r(x0)===r(x1)&&r(y0)===r(y1)}}function path(){return new Path}var pi,tau,epsilon,
tauEpsilon,Path,init_d3_path=__esm({"node_modules/d3-path/dist/d3-path.mjs"(){pi=Math.PI,tau=2*pi,epsilon=1e-6,
tauEpsilon=tau-epsilon;Path=class{constructor(digits2){this._x0=this._y0=this._x1=this._y1=null,this._="",this.
_append=digits2==null?append:appendRound(digits2),this._equal=digits2==null?equal:equalRound(digits2)}moveTo(x2,y2){
this._append`M${this._x0=this._x1=+x2},${this._y0=this._y1=+y2}`}closePath(){this._x1!==null&&(this._x1=this._x0,
this._y1=this._y0,this._append`Z`)}lineTo(x2,y2){this._append`L${this._x1=+x2},${this._y1=+y2}`}quadraticCurveTo(x1,y1,x2,y2){
this._append`Q${+x1},${+y1},${this._x1=+x2},${this._y1=+y2}`}bezierCurveTo(x1,y1,x2,y2,x3,y3){this._append`C${+x1},${+y1},${+x2},${+y2},${this.
_x1=+x3},${this._y1=+y3}`}arcTo(x1,y1,x2,y2,r){if(x1=+x1,y1=+y1,x2=+x2,y2=+y2,r=+r,r<0)throw new Error(`negati\
ve radius: ${r}`);let x0=this._x1,y0=this._y1,x21=x2-x1,y21=y2-y1,x01=x0-x1,y01=y0-y1,l01_2=x01*x01+y01*y01;if(this.
_x1===null)this._append`M${this._x1=x1},${this._y1=y1}`;else if(l01_2>epsilon)if(!(Math.abs(y01*x21-y21*x01)>epsilon)||
!r)this._append`L${this._x1=x1},${this._y1=y1}`;else{let x20=x2-x0,y20=y2-y0,l21_2=x21*x21+y21*y21,l20_2=x20*x20+
y20*y20,l21=Math.sqrt(l21_2),l01=Math.sqrt(l01_2),l=r*Math.tan((pi-Math.acos((l21_2+l01_2-l20_2)/(2*l21*l01)))/
2),t01=l/l01,t21=l/l21;Math.abs(t01-1)>epsilon&&this._append`L${x1+t01*x01},${y1+t01*y01}`,this._append`A${r},${r},0,0,${+(y01*
x20>x01*y20)},${this._x1=x1+t21*x21},${this._y1=y1+t21*y21}`}}arc(x2,y2,r,a0,a1,ccw){if(x2=+x2,y2=+y2,r=+r,ccw=
!!ccw,r<0)throw new Error(`negative radius: ${r}`);let dx=r*Math.cos(a0),dy=r*Math.sin(a0),x0=x2+dx,y0=y2+dy,cw=1^
ccw,da=ccw?a0-a1:a1-a0;if(this._x1===null?this._append`M${x0},${y0}`:(Math.abs(this._x1-x0)>epsilon||Math.abs(
this._y1-y0)>epsilon)&&this._append`L${x0},${y0}`,!!r){if(da<0&&(da=da%tau+tau),da>tauEpsilon)this._append`A${r},${r},0,1,${cw},${x2-
dx},${y2-dy}A${r},${r},0,1,${cw},${this._x1=x0},${this._y1=y0}`;else if(da>epsilon){let x1=x2+r*Math.cos(a1),y1=y2+
r*Math.sin(a1);if(da>=pi&&this._equal(x0,y0,x1,y1)){da/=2;let a00=a0+da;this._append`A${r},${r},0,${+(da>=pi)},${cw},${x2+
r*Math.cos(a00)},${y2+r*Math.sin(a00)}`}this._append`A${r},${r},0,${+(da>=pi)},${cw},${this._x1=x1},${this._y1=
y1}`}}}rect(x2,y2,w,h){this._append`M${this._x0=this._x1=+x2},${this._y0=this._y1=+y2}h${w=+w}v${+h}h${-w}Z`}toString(){
return this._}};path.prototype=Path.prototype}});function constant(x2){return function(){return x2}}function withPath(shape){let digits2=3;return shape.digits=
function(_){if(!arguments.length)return digits2;if(_==null)digits2=null;else{let d=Math.floor(_);if(!(d>=0))throw new RangeError(
`invalid digits: ${_}`);digits2=d}return shape},()=>new Path(digits2)}function array2(x2){return typeof x2=="o\
bject"&&"length"in x2?x2:Array.from(x2)}function Linear(context){this._context=context}function curveLinear(context){
return new Linear(context)}function x(p){return p[0]}function y(p){return p[1]}function line(x$1,y$1){var defined=constant(
!0),context=null,curve=curveLinear,output=null,path2=withPath(line2);x$1=typeof x$1=="function"?x$1:x$1===void 0?
x:constant(x$1),y$1=typeof y$1=="function"?y$1:y$1===void 0?y:constant(y$1);function line2(data){var i,n=(data=
array2(data)).length,d,defined0=!1,buffer;for(context==null&&(output=curve(buffer=path2())),i=0;i<=n;++i)!(i<n&&
defined(d=data[i],i,data))===defined0&&((defined0=!defined0)?output.lineStart():output.lineEnd()),defined0&&output.
point(+x$1(d,i,data),+y$1(d,i,data));if(buffer)return output=null,buffer+""||null}return line2.x=function(_){return arguments.
length?(x$1=typeof _=="function"?_:constant(+_),line2):x$1},line2.y=function(_){return arguments.length?(y$1=typeof _==
"function"?_:constant(+_),line2):y$1},line2.defined=function(_){return arguments.length?(defined=typeof _=="fu\
nction"?_:constant(!!_),line2):defined},line2.curve=function(_){return arguments.length?(curve=_,context!=null&&
(output=curve(context)),line2):curve},line2.context=function(_){return arguments.length?(_==null?context=output=
null:output=curve(context=_),line2):context},line2}function area(x0,y0,y1){var x1=null,defined=constant(!0),context=null,
curve=curveLinear,output=null,path2=withPath(area2);x0=typeof x0=="function"?x0:x0===void 0?x:constant(+x0),y0=
typeof y0=="function"?y0:constant(y0===void 0?0:+y0),y1=typeof y1=="function"?y1:y1===void 0?y:constant(+y1);function area2(data){
var i,j,k2,n=(data=array2(data)).length,d,defined0=!1,buffer,x0z=new Array(n),y0z=new Array(n);for(context==null&&
(output=curve(buffer=path2())),i=0;i<=n;++i){if(!(i<n&&defined(d=data[i],i,data))===defined0)if(defined0=!defined0)
j=i,output.areaStart(),output.lineStart();else{for(output.lineEnd(),output.lineStart(),k2=i-1;k2>=j;--k2)output.
point(x0z[k2],y0z[k2]);output.lineEnd(),output.areaEnd()}defined0&&(x0z[i]=+x0(d,i,data),y0z[i]=+y0(d,i,data),
output.point(x1?+x1(d,i,data):x0z[i],y1?+y1(d,i,data):y0z[i]))}if(buffer)return output=null,buffer+""||null}function arealine(){
return line().defined(defined).curve(curve).context(context)}return area2.x=function(_){return arguments.length?
(x0=typeof _=="function"?_:constant(+_),x1=null,area2):x0},area2.x0=function(_){return arguments.length?(x0=typeof _==
"function"?_:constant(+_),area2):x0},area2.x1=function(_){return arguments.length?(x1=_==null?null:typeof _=="\
function"?_:constant(+_),area2):x1},area2.y=function(_){return arguments.length?(y0=typeof _=="function"?_:constant(
+_),y1=null,area2):y0},area2.y0=function(_){return arguments.length?(y0=typeof _=="function"?_:constant(+_),area2):
y0},area2.y1=function(_){return arguments.length?(y1=_==null?null:typeof _=="function"?_:constant(+_),area2):y1},
area2.lineX0=area2.lineY0=function(){return arealine().x(x0).y(y0)},area2.lineY1=function(){return arealine().
x(x0).y(y1)},area2.lineX1=function(){return arealine().x(x1).y(y0)},area2.defined=function(_){return arguments.
length?(defined=typeof _=="function"?_:constant(!!_),area2):defined},area2.curve=function(_){return arguments.
length?(curve=_,context!=null&&(output=curve(context)),area2):curve},area2.context=function(_){return arguments.
length?(_==null?context=output=null:output=curve(context=_),area2):context},area2}function Radial(curve){this.
_curve=curve}function curveRadial(curve){function radial(context){return new Radial(curve(context))}return radial.
_curve=curve,radial}function noop(){}function point$3(that,x2,y2){that._context.bezierCurveTo((2*that._x0+that.
_x1)/3,(2*that._y0+that._y1)/3,(that._x0+2*that._x1)/3,(that._y0+2*that._y1)/3,(that._x0+4*that._x1+x2)/6,(that.
_y0+4*that._y1+y2)/6)}function Basis(context){this._context=context}function BasisClosed(context){this._context=
context}function BasisOpen(context){this._context=context}function Bundle(context,beta){this._basis=new Basis(
context),this._beta=beta}function point$2(that,x2,y2){that._context.bezierCurveTo(that._x1+that._k*(that._x2-that.
_x0),that._y1+that._k*(that._y2-that._y0),that._x2+that._k*(that._x1-x2),that._y2+that._k*(that._y1-y2),that._x2,
that._y2)}function Cardinal(context,tension){this._context=context,this._k=(1-tension)/6}function CardinalClosed(context,tension){
this._context=context,this._k=(1-tension)/6}function CardinalOpen(context,tension){this._context=context,this.
_k=(1-tension)/6}function point$1(that,x2,y2){var x1=that._x1,y1=that._y1,x22=that._x2,y22=that._y2;if(that._l01_a>
epsilon2){var a2=2*that._l01_2a+3*that._l01_a*that._l12_a+that._l12_2a,n=3*that._l01_a*(that._l01_a+that._l12_a);
x1=(x1*a2-that._x0*that._l12_2a+that._x2*that._l01_2a)/n,y1=(y1*a2-that._y0*that._l12_2a+that._y2*that._l01_2a)/
n}if(that._l23_a>epsilon2){var b=2*that._l23_2a+3*that._l23_a*that._l12_a+that._l12_2a,m=3*that._l23_a*(that._l23_a+
that._l12_a);x22=(x22*b+that._x1*that._l23_2a-x2*that._l12_2a)/m,y22=(y22*b+that._y1*that._l23_2a-y2*that._l12_2a)/
m}that._context.bezierCurveTo(x1,y1,x22,y22,that._x2,that._y2)}function CatmullRom(context,alpha){this._context=
context,this._alpha=alpha}function CatmullRomClosed(context,alpha){this._context=context,this._alpha=alpha}function CatmullRomOpen(context,alpha){
this._context=context,this._alpha=alpha}function LinearClosed(context){this._context=context}function sign(x2){
return x2<0?-1:1}function slope3(that,x2,y2){var h0=that._x1-that._x0,h1=x2-that._x1,s0=(that._y1-that._y0)/(h0||
h1<0&&-0),s1=(y2-that._y1)/(h1||h0<0&&-0),p=(s0*h1+s1*h0)/(h0+h1);return(sign(s0)+sign(s1))*Math.min(Math.abs(
s0),Math.abs(s1),.5*Math.abs(p))||0}function slope2(that,t){var h=that._x1-that._x0;return h?(3*(that._y1-that.
_y0)/h-t)/2:t}function point(that,t02,t12){var x0=that._x0,y0=that._y0,x1=that._x1,y1=that._y1,dx=(x1-x0)/3;that.
_context.bezierCurveTo(x0+dx,y0+dx*t02,x1-dx,y1-dx*t12,x1,y1)}function MonotoneX(context){this._context=context}
function MonotoneY(context){this._context=new ReflectContext(context)}function ReflectContext(context){this._context=
context}function Natural(context){this._context=context}function controlPoints(x2){var i,n=x2.length-1,m,a2=new Array(
n),b=new Array(n),r=new Array(n);for(a2[0]=0,b[0]=2,r[0]=x2[0]+2*x2[1],i=1;i<n-1;++i)a2[i]=1,b[i]=4,r[i]=4*x2[i]+
2*x2[i+1];for(a2[n-1]=2,b[n-1]=7,r[n-1]=8*x2[n-1]+x2[n],i=1;i<n;++i)m=a2[i]/b[i-1],b[i]-=m,r[i]-=m*r[i-1];for(a2[n-
1]=r[n-1]/b[n-1],i=n-2;i>=0;--i)a2[i]=(r[i]-a2[i+1])/b[i];for(b[n-1]=(x2[n]+a2[n-1])/2,i=0;i<n-1;++i)b[i]=2*x2[i+
1]-a2[i+1];return[a2,b]}function Step(context,t){this._context=context,this._t=t}var cos,sin,sqrt,epsilon2,pi2,
halfPi,tau2,slice2,curveRadialLinear,sqrt3$2,tan30,tan30_2,kr,kx,ky,sqrt3$1,sqrt3,s,k,a,bundle,cardinal,cardinalClosed,
cardinalOpen,catmullRom,catmullRomClosed,catmullRomOpen,init_d3_shape=__esm({"node_modules/d3-shape/dist/d3-sh\
ape.mjs"(){init_d3_path();cos=Math.cos,sin=Math.sin,sqrt=Math.sqrt,epsilon2=1e-12,pi2=Math.PI,halfPi=pi2/2,tau2=
2*pi2;slice2=Array.prototype.slice;Linear.prototype={areaStart:function(){this._line=0},areaEnd:function(){this.
_line=NaN},lineStart:function(){this._point=0},lineEnd:function(){(this._line||this._line!==0&&this._point===1)&&
this._context.closePath(),this._line=1-this._line},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:
this._point=1,this._line?this._context.lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:this._point=2;default:
this._context.lineTo(x2,y2);break}}};curveRadialLinear=curveRadial(curveLinear);Radial.prototype={areaStart:function(){
this._curve.areaStart()},areaEnd:function(){this._curve.areaEnd()},lineStart:function(){this._curve.lineStart()},
lineEnd:function(){this._curve.lineEnd()},point:function(a2,r){this._curve.point(r*Math.sin(a2),r*-Math.cos(a2))}};
sqrt3$2=sqrt(3),tan30=sqrt(1/3),tan30_2=tan30*2,kr=sin(pi2/10)/sin(7*pi2/10),kx=sin(tau2/10)*kr,ky=-cos(tau2/10)*
kr,sqrt3$1=sqrt(3),sqrt3=sqrt(3),s=sqrt(3)/2,k=1/sqrt(12),a=(k/2+1)*3;Basis.prototype={areaStart:function(){this.
_line=0},areaEnd:function(){this._line=NaN},lineStart:function(){this._x0=this._x1=this._y0=this._y1=NaN,this.
_point=0},lineEnd:function(){switch(this._point){case 3:point$3(this,this._x1,this._y1);case 2:this._context.lineTo(
this._x1,this._y1);break}(this._line||this._line!==0&&this._point===1)&&this._context.closePath(),this._line=1-
this._line},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:this._point=1,this._line?this._context.
lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:this._point=2;break;case 2:this._point=3,this._context.
lineTo((5*this._x0+this._x1)/6,(5*this._y0+this._y1)/6);default:point$3(this,x2,y2);break}this._x0=this._x1,this.
_x1=x2,this._y0=this._y1,this._y1=y2}};BasisClosed.prototype={areaStart:noop,areaEnd:noop,lineStart:function(){
this._x0=this._x1=this._x2=this._x3=this._x4=this._y0=this._y1=this._y2=this._y3=this._y4=NaN,this._point=0},lineEnd:function(){
switch(this._point){case 1:{this._context.moveTo(this._x2,this._y2),this._context.closePath();break}case 2:{this.
_context.moveTo((this._x2+2*this._x3)/3,(this._y2+2*this._y3)/3),this._context.lineTo((this._x3+2*this._x2)/3,
(this._y3+2*this._y2)/3),this._context.closePath();break}case 3:{this.point(this._x2,this._y2),this.point(this.
_x3,this._y3),this.point(this._x4,this._y4);break}}},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:
this._point=1,this._x2=x2,this._y2=y2;break;case 1:this._point=2,this._x3=x2,this._y3=y2;break;case 2:this._point=
3,this._x4=x2,this._y4=y2,this._context.moveTo((this._x0+4*this._x1+x2)/6,(this._y0+4*this._y1+y2)/6);break;default:
point$3(this,x2,y2);break}this._x0=this._x1,this._x1=x2,this._y0=this._y1,this._y1=y2}};BasisOpen.prototype={areaStart:function(){
this._line=0},areaEnd:function(){this._line=NaN},lineStart:function(){this._x0=this._x1=this._y0=this._y1=NaN,
this._point=0},lineEnd:function(){(this._line||this._line!==0&&this._point===3)&&this._context.closePath(),this.
_line=1-this._line},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:this._point=1;break;case 1:
this._point=2;break;case 2:this._point=3;var x0=(this._x0+4*this._x1+x2)/6,y0=(this._y0+4*this._y1+y2)/6;this.
_line?this._context.lineTo(x0,y0):this._context.moveTo(x0,y0);break;case 3:this._point=4;default:point$3(this,
x2,y2);break}this._x0=this._x1,this._x1=x2,this._y0=this._y1,this._y1=y2}};Bundle.prototype={lineStart:function(){
this._x=[],this._y=[],this._basis.lineStart()},lineEnd:function(){var x2=this._x,y2=this._y,j=x2.length-1;if(j>
0)for(var x0=x2[0],y0=y2[0],dx=x2[j]-x0,dy=y2[j]-y0,i=-1,t;++i<=j;)t=i/j,this._basis.point(this._beta*x2[i]+(1-
this._beta)*(x0+t*dx),this._beta*y2[i]+(1-this._beta)*(y0+t*dy));this._x=this._y=null,this._basis.lineEnd()},point:function(x2,y2){
this._x.push(+x2),this._y.push(+y2)}};bundle=(function custom(beta){function bundle2(context){return beta===1?
new Basis(context):new Bundle(context,beta)}return bundle2.beta=function(beta2){return custom(+beta2)},bundle2})(
.85);Cardinal.prototype={areaStart:function(){this._line=0},areaEnd:function(){this._line=NaN},lineStart:function(){
this._x0=this._x1=this._x2=this._y0=this._y1=this._y2=NaN,this._point=0},lineEnd:function(){switch(this._point){case 2:
this._context.lineTo(this._x2,this._y2);break;case 3:point$2(this,this._x1,this._y1);break}(this._line||this._line!==
0&&this._point===1)&&this._context.closePath(),this._line=1-this._line},point:function(x2,y2){switch(x2=+x2,y2=
+y2,this._point){case 0:this._point=1,this._line?this._context.lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:
this._point=2,this._x1=x2,this._y1=y2;break;case 2:this._point=3;default:point$2(this,x2,y2);break}this._x0=this.
_x1,this._x1=this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};cardinal=(function custom2(tension){
function cardinal2(context){return new Cardinal(context,tension)}return cardinal2.tension=function(tension2){return custom2(
+tension2)},cardinal2})(0);CardinalClosed.prototype={areaStart:noop,areaEnd:noop,lineStart:function(){this._x0=
this._x1=this._x2=this._x3=this._x4=this._x5=this._y0=this._y1=this._y2=this._y3=this._y4=this._y5=NaN,this._point=
0},lineEnd:function(){switch(this._point){case 1:{this._context.moveTo(this._x3,this._y3),this._context.closePath();
break}case 2:{this._context.lineTo(this._x3,this._y3),this._context.closePath();break}case 3:{this.point(this.
_x3,this._y3),this.point(this._x4,this._y4),this.point(this._x5,this._y5);break}}},point:function(x2,y2){switch(x2=
+x2,y2=+y2,this._point){case 0:this._point=1,this._x3=x2,this._y3=y2;break;case 1:this._point=2,this._context.
moveTo(this._x4=x2,this._y4=y2);break;case 2:this._point=3,this._x5=x2,this._y5=y2;break;default:point$2(this,
x2,y2);break}this._x0=this._x1,this._x1=this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};
cardinalClosed=(function custom3(tension){function cardinal2(context){return new CardinalClosed(context,tension)}
return cardinal2.tension=function(tension2){return custom3(+tension2)},cardinal2})(0);CardinalOpen.prototype={
areaStart:function(){this._line=0},areaEnd:function(){this._line=NaN},lineStart:function(){this._x0=this._x1=this.
_x2=this._y0=this._y1=this._y2=NaN,this._point=0},lineEnd:function(){(this._line||this._line!==0&&this._point===
3)&&this._context.closePath(),this._line=1-this._line},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:
this._point=1;break;case 1:this._point=2;break;case 2:this._point=3,this._line?this._context.lineTo(this._x2,this.
_y2):this._context.moveTo(this._x2,this._y2);break;case 3:this._point=4;default:point$2(this,x2,y2);break}this.
_x0=this._x1,this._x1=this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};cardinalOpen=(function custom4(tension){
function cardinal2(context){return new CardinalOpen(context,tension)}return cardinal2.tension=function(tension2){
return custom4(+tension2)},cardinal2})(0);CatmullRom.prototype={areaStart:function(){this._line=0},areaEnd:function(){
this._line=NaN},lineStart:function(){this._x0=this._x1=this._x2=this._y0=this._y1=this._y2=NaN,this._l01_a=this.
_l12_a=this._l23_a=this._l01_2a=this._l12_2a=this._l23_2a=this._point=0},lineEnd:function(){switch(this._point){case 2:
this._context.lineTo(this._x2,this._y2);break;case 3:this.point(this._x2,this._y2);break}(this._line||this._line!==
0&&this._point===1)&&this._context.closePath(),this._line=1-this._line},point:function(x2,y2){if(x2=+x2,y2=+y2,
this._point){var x23=this._x2-x2,y23=this._y2-y2;this._l23_a=Math.sqrt(this._l23_2a=Math.pow(x23*x23+y23*y23,this.
_alpha))}switch(this._point){case 0:this._point=1,this._line?this._context.lineTo(x2,y2):this._context.moveTo(
x2,y2);break;case 1:this._point=2;break;case 2:this._point=3;default:point$1(this,x2,y2);break}this._l01_a=this.
_l12_a,this._l12_a=this._l23_a,this._l01_2a=this._l12_2a,this._l12_2a=this._l23_2a,this._x0=this._x1,this._x1=
this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};catmullRom=(function custom5(alpha){function catmullRom2(context){
return alpha?new CatmullRom(context,alpha):new Cardinal(context,0)}return catmullRom2.alpha=function(alpha2){return custom5(
+alpha2)},catmullRom2})(.5);CatmullRomClosed.prototype={areaStart:noop,areaEnd:noop,lineStart:function(){this.
_x0=this._x1=this._x2=this._x3=this._x4=this._x5=this._y0=this._y1=this._y2=this._y3=this._y4=this._y5=NaN,this.
_l01_a=this._l12_a=this._l23_a=this._l01_2a=this._l12_2a=this._l23_2a=this._point=0},lineEnd:function(){switch(this.
_point){case 1:{this._context.moveTo(this._x3,this._y3),this._context.closePath();break}case 2:{this._context.
lineTo(this._x3,this._y3),this._context.closePath();break}case 3:{this.point(this._x3,this._y3),this.point(this.
_x4,this._y4),this.point(this._x5,this._y5);break}}},point:function(x2,y2){if(x2=+x2,y2=+y2,this._point){var x23=this.
_x2-x2,y23=this._y2-y2;this._l23_a=Math.sqrt(this._l23_2a=Math.pow(x23*x23+y23*y23,this._alpha))}switch(this._point){case 0:
this._point=1,this._x3=x2,this._y3=y2;break;case 1:this._point=2,this._context.moveTo(this._x4=x2,this._y4=y2);
break;case 2:this._point=3,this._x5=x2,this._y5=y2;break;default:point$1(this,x2,y2);break}this._l01_a=this._l12_a,
this._l12_a=this._l23_a,this._l01_2a=this._l12_2a,this._l12_2a=this._l23_2a,this._x0=this._x1,this._x1=this._x2,
this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};catmullRomClosed=(function custom6(alpha){function catmullRom2(context){
return alpha?new CatmullRomClosed(context,alpha):new CardinalClosed(context,0)}return catmullRom2.alpha=function(alpha2){
return custom6(+alpha2)},catmullRom2})(.5);CatmullRomOpen.prototype={areaStart:function(){this._line=0},areaEnd:function(){
this._line=NaN},lineStart:function(){this._x0=this._x1=this._x2=this._y0=this._y1=this._y2=NaN,this._l01_a=this.
_l12_a=this._l23_a=this._l01_2a=this._l12_2a=this._l23_2a=this._point=0},lineEnd:function(){(this._line||this.
_line!==0&&this._point===3)&&this._context.closePath(),this._line=1-this._line},point:function(x2,y2){if(x2=+x2,
y2=+y2,this._point){var x23=this._x2-x2,y23=this._y2-y2;this._l23_a=Math.sqrt(this._l23_2a=Math.pow(x23*x23+y23*
y23,this._alpha))}switch(this._point){case 0:this._point=1;break;case 1:this._point=2;break;case 2:this._point=
3,this._line?this._context.lineTo(this._x2,this._y2):this._context.moveTo(this._x2,this._y2);break;case 3:this.
_point=4;default:point$1(this,x2,y2);break}this._l01_a=this._l12_a,this._l12_a=this._l23_a,this._l01_2a=this._l12_2a,
this._l12_2a=this._l23_2a,this._x0=this._x1,this._x1=this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,
this._y2=y2}};catmullRomOpen=(function custom7(alpha){function catmullRom2(context){return alpha?new CatmullRomOpen(
context,alpha):new CardinalOpen(context,0)}return catmullRom2.alpha=function(alpha2){return custom7(+alpha2)},
catmullRom2})(.5);LinearClosed.prototype={areaStart:noop,areaEnd:noop,lineStart:function(){this._point=0},lineEnd:function(){
this._point&&this._context.closePath()},point:function(x2,y2){x2=+x2,y2=+y2,this._point?this._context.lineTo(x2,
y2):(this._point=1,this._context.moveTo(x2,y2))}};MonotoneX.prototype={areaStart:function(){this._line=0},areaEnd:function(){
this._line=NaN},lineStart:function(){this._x0=this._x1=this._y0=this._y1=this._t0=NaN,this._point=0},lineEnd:function(){
switch(this._point){case 2:this._context.lineTo(this._x1,this._y1);break;case 3:point(this,this._t0,slope2(this,
this._t0));break}(this._line||this._line!==0&&this._point===1)&&this._context.closePath(),this._line=1-this._line},
point:function(x2,y2){var t12=NaN;if(x2=+x2,y2=+y2,!(x2===this._x1&&y2===this._y1)){switch(this._point){case 0:
this._point=1,this._line?this._context.lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:this._point=2;break;case 2:
this._point=3,point(this,slope2(this,t12=slope3(this,x2,y2)),t12);break;default:point(this,this._t0,t12=slope3(
this,x2,y2));break}this._x0=this._x1,this._x1=x2,this._y0=this._y1,this._y1=y2,this._t0=t12}}};(MonotoneY.prototype=
Object.create(MonotoneX.prototype)).point=function(x2,y2){MonotoneX.prototype.point.call(this,y2,x2)};ReflectContext.
prototype={moveTo:function(x2,y2){this._context.moveTo(y2,x2)},closePath:function(){this._context.closePath()},
lineTo:function(x2,y2){this._context.lineTo(y2,x2)},bezierCurveTo:function(x1,y1,x2,y2,x3,y3){this._context.bezierCurveTo(
y1,x1,y2,x2,y3,x3)}};Natural.prototype={areaStart:function(){this._line=0},areaEnd:function(){this._line=NaN},
lineStart:function(){this._x=[],this._y=[]},lineEnd:function(){var x2=this._x,y2=this._y,n=x2.length;if(n)if(this.
_line?this._context.lineTo(x2[0],y2[0]):this._context.moveTo(x2[0],y2[0]),n===2)this._context.lineTo(x2[1],y2[1]);else
for(var px=controlPoints(x2),py=controlPoints(y2),i0=0,i1=1;i1<n;++i0,++i1)this._context.bezierCurveTo(px[0][i0],
py[0][i0],px[1][i0],py[1][i0],x2[i1],y2[i1]);(this._line||this._line!==0&&n===1)&&this._context.closePath(),this.
_line=1-this._line,this._x=this._y=null},point:function(x2,y2){this._x.push(+x2),this._y.push(+y2)}};Step.prototype=
{areaStart:function(){this._line=0},areaEnd:function(){this._line=NaN},lineStart:function(){this._x=this._y=NaN,
this._point=0},lineEnd:function(){0<this._t&&this._t<1&&this._point===2&&this._context.lineTo(this._x,this._y),
(this._line||this._line!==0&&this._point===1)&&this._context.closePath(),this._line>=0&&(this._t=1-this._t,this.
_line=1-this._line)},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:this._point=1,this._line?this.
_context.lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:this._point=2;default:{if(this._t<=0)this._context.
lineTo(this._x,y2),this._context.lineTo(x2,y2);else{var x1=this._x*(1-this._t)+x2*this._t;this._context.lineTo(
x1,this._y),this._context.lineTo(x1,y2)}break}}this._x=x2,this._y=y2}}}});function measure(words,font){return ruler.font=writeFont(font),ruler.measureText(words).width}function make(name,attributes){
let made2=document.createElementNS(SVG,name);for(let[key,value]of Object.entries(attributes))value!==void 0&&made2.
setAttribute(key,String(value));return made2}function paint(name,shade,opacity=1){let{opacity:own}=rgb(shade??
"#000"),share=own*opacity;return{[name]:shade?rgb(shade).formatHex():"none",[`${name}-opacity`]:share<1?share.
toFixed(2):void 0}}var FAMILY,SVG,HALO,MIDDLE2,FONTS,writeFont,ruler,trace,traceBox,Screen,Figure,init_sheet=__esm(
{"needlefit/viewer/page/sheet.js"(){"use strict";init_d3_color();init_d3_shape();init_dom();FAMILY="Arial, Lib\
eration Sans, Helvetica, sans-serif",SVG="http://www.w3.org/2000/svg",HALO=4,MIDDLE2=.35,FONTS={small:[400,11],
plain:[400,12],strong:[600,12]},writeFont=font=>`${FONTS[font][0]} ${FONTS[font][1]}px ${FAMILY}`,ruler=getContext(
document.createElement("canvas"));trace=places=>line()(places)??"",traceBox=({left,top,width,height})=>`${trace(
[[left,top],[left+width,top],[left+width,top+height],[left,top+height]])}Z`,Screen=class{constructor(context){
this.context=context,Object.assign(context,{lineJoin:"round"})}path(d,{fill,stroke,width=1,dash=[],opacity=1}){
let{context}=this,path2=new Path2D(d);Object.assign(context,{globalAlpha:opacity,fillStyle:fill,strokeStyle:stroke,
lineWidth:width}),context.setLineDash(dash),fill&&context.fill(path2),stroke&&context.stroke(path2)}text(words,[
x2,y2],{fill,font="small",align="center",halo}){let{context}=this;Object.assign(context,{globalAlpha:1,font:writeFont(
font),textAlign:align,fillStyle:fill,strokeStyle:halo,lineWidth:HALO}),context.setLineDash([]);let base=y2+MIDDLE2*
FONTS[font][1];halo&&context.strokeText(words,x2,base),context.fillText(words,x2,base)}#apart(draw2){this.context.
save(),draw2(),this.context.restore()}within(box,draw2){this.#apart(()=>{this.context.clip(new Path2D(traceBox(
box))),draw2()})}turned([x2,y2],angle2,draw2){this.#apart(()=>{this.context.translate(x2,y2),this.context.rotate(
-angle2),draw2()})}};Figure=class{#clips=0;constructor([width,height],wide,title,words){this.svg=this.group=make(
"svg",{width:`${wide}mm`,height:`${(wide*height/width).toFixed(2)}mm`,viewBox:`0 0 ${width.toFixed(2)} ${height.
toFixed(2)}`,"font-family":FAMILY,"stroke-linejoin":"round"}),this.#add("title",{}).textContent=title,this.#add(
"desc",{}).textContent=words}#add(name,attributes){let made2=make(name,attributes);return this.group.append(made2),
made2}path(d,{fill,stroke,width=1,dash=[],opacity=1}){this.#add("path",{d,...paint("fill",fill,opacity),...stroke&&
{...paint("stroke",stroke,opacity),"stroke-width":width},"stroke-dasharray":dash.join(" ")||void 0})}text(words,[
x2,y2],{fill,font="small",align="center",halo}){let[weight,size2]=FONTS[font];this.#add("text",{x:x2.toFixed(2),
y:(y2+MIDDLE2*size2).toFixed(2),"font-size":size2,"font-weight":weight,"text-anchor":align.replace("center","m\
iddle"),...paint("fill",fill),...halo&&{...paint("stroke",halo),"stroke-width":HALO,"paint-order":"stroke"}}).
textContent=words}#apart(attributes,draw2){let outer=this.group;this.group=this.#add("g",attributes),draw2(),this.
group=outer}within(box,draw2){this.#clips+=1;let id=`clip-${this.#clips}`;this.#add("clipPath",{id}).append(make(
"path",{d:traceBox(box)})),this.#apart({"clip-path":`url(#${id})`},draw2)}turned([x2,y2],angle2,draw2){this.#apart(
{transform:`translate(${x2.toFixed(2)} ${y2.toFixed(2)}) rotate(${(-angle2*180/Math.PI).toFixed(2)})`},draw2)}}}});function basis(t12,v0,v1,v2,v3){var t22=t12*t12,t32=t22*t12;return((1-3*t12+3*t22-t32)*v0+(4-6*t22+3*t32)*v1+(1+
3*t12+3*t22-3*t32)*v2+t32*v3)/6}function basis$1(values){var n=values.length-1;return function(t){var i=t<=0?t=
0:t>=1?(t=1,n-1):Math.floor(t*n),v1=values[i],v2=values[i+1],v0=i>0?values[i-1]:2*v1-v2,v3=i<n-1?values[i+2]:2*
v2-v1;return basis((t-i/n)*n,v0,v1,v2,v3)}}function basisClosed(values){var n=values.length;return function(t){
var i=Math.floor(((t%=1)<0?++t:t)*n),v0=values[(i+n-1)%n],v1=values[i%n],v2=values[(i+1)%n],v3=values[(i+2)%n];
return basis((t-i/n)*n,v0,v1,v2,v3)}}function linear(a2,d){return function(t){return a2+t*d}}function exponential(a2,b,y2){
return a2=Math.pow(a2,y2),b=Math.pow(b,y2)-a2,y2=1/y2,function(t){return Math.pow(a2+t*b,y2)}}function hue$1(a2,b){
var d=b-a2;return d?linear(a2,d>180||d<-180?d-360*Math.round(d/360):d):constant2(isNaN(a2)?b:a2)}function gamma(y2){
return(y2=+y2)==1?nogamma:function(a2,b){return b-a2?exponential(a2,b,y2):constant2(isNaN(a2)?b:a2)}}function nogamma(a2,b){
var d=b-a2;return d?linear(a2,d):constant2(isNaN(a2)?b:a2)}function rgbSpline(spline){return function(colors){
var n=colors.length,r=new Array(n),g=new Array(n),b=new Array(n),i,color2;for(i=0;i<n;++i)color2=rgb(colors[i]),
r[i]=color2.r||0,g[i]=color2.g||0,b[i]=color2.b||0;return r=spline(r),g=spline(g),b=spline(b),color2.opacity=1,
function(t){return color2.r=r(t),color2.g=g(t),color2.b=b(t),color2+""}}}function number2(a2,b){return a2=+a2,
b=+b,function(t){return a2*(1-t)+b*t}}function decompose(a2,b,c,d,e,f){var scaleX,scaleY,skewX;return(scaleX=Math.
sqrt(a2*a2+b*b))&&(a2/=scaleX,b/=scaleX),(skewX=a2*c+b*d)&&(c-=a2*skewX,d-=b*skewX),(scaleY=Math.sqrt(c*c+d*d))&&
(c/=scaleY,d/=scaleY,skewX/=scaleY),a2*d<b*c&&(a2=-a2,b=-b,skewX=-skewX,scaleX=-scaleX),{translateX:e,translateY:f,
rotate:Math.atan2(b,a2)*degrees3,skewX:Math.atan(skewX)*degrees3,scaleX,scaleY}}function parseCss(value){let m=new(typeof DOMMatrix==
"function"?DOMMatrix:WebKitCSSMatrix)(value+"");return m.isIdentity?identity:decompose(m.a,m.b,m.c,m.d,m.e,m.f)}
function parseSvg(value){return value==null||(svgNode||(svgNode=document.createElementNS("http://www.w3.org/20\
00/svg","g")),svgNode.setAttribute("transform",value),!(value=svgNode.transform.baseVal.consolidate()))?identity:
(value=value.matrix,decompose(value.a,value.b,value.c,value.d,value.e,value.f))}function interpolateTransform(parse,pxComma,pxParen,degParen){
function pop(s2){return s2.length?s2.pop()+" ":""}function translate(xa,ya,xb,yb,s2,q){if(xa!==xb||ya!==yb){var i=s2.
push("translate(",null,pxComma,null,pxParen);q.push({i:i-4,x:number2(xa,xb)},{i:i-2,x:number2(ya,yb)})}else(xb||
yb)&&s2.push("translate("+xb+pxComma+yb+pxParen)}function rotate(a2,b,s2,q){a2!==b?(a2-b>180?b+=360:b-a2>180&&
(a2+=360),q.push({i:s2.push(pop(s2)+"rotate(",null,degParen)-2,x:number2(a2,b)})):b&&s2.push(pop(s2)+"rotate("+
b+degParen)}function skewX(a2,b,s2,q){a2!==b?q.push({i:s2.push(pop(s2)+"skewX(",null,degParen)-2,x:number2(a2,
b)}):b&&s2.push(pop(s2)+"skewX("+b+degParen)}function scale(xa,ya,xb,yb,s2,q){if(xa!==xb||ya!==yb){var i=s2.push(
pop(s2)+"scale(",null,",",null,")");q.push({i:i-4,x:number2(xa,xb)},{i:i-2,x:number2(ya,yb)})}else(xb!==1||yb!==
1)&&s2.push(pop(s2)+"scale("+xb+","+yb+")")}return function(a2,b){var s2=[],q=[];return a2=parse(a2),b=parse(b),
translate(a2.translateX,a2.translateY,b.translateX,b.translateY,s2,q),rotate(a2.rotate,b.rotate,s2,q),skewX(a2.
skewX,b.skewX,s2,q),scale(a2.scaleX,a2.scaleY,b.scaleX,b.scaleY,s2,q),a2=b=null,function(t){for(var i=-1,n=q.length,
o;++i<n;)s2[(o=q[i]).i]=o.x(t);return s2.join("")}}}function cosh(x2){return((x2=Math.exp(x2))+1/x2)/2}function sinh(x2){
return((x2=Math.exp(x2))-1/x2)/2}function tanh(x2){return((x2=Math.exp(2*x2))-1)/(x2+1)}function hsl2(hue){return function(start2,end){
var h=hue((start2=hsl(start2)).h,(end=hsl(end)).h),s2=nogamma(start2.s,end.s),l=nogamma(start2.l,end.l),opacity=nogamma(
start2.opacity,end.opacity);return function(t){return start2.h=h(t),start2.s=s2(t),start2.l=l(t),start2.opacity=
opacity(t),start2+""}}}function hcl2(hue){return function(start2,end){var h=hue((start2=hcl(start2)).h,(end=hcl(
end)).h),c=nogamma(start2.c,end.c),l=nogamma(start2.l,end.l),opacity=nogamma(start2.opacity,end.opacity);return function(t){
return start2.h=h(t),start2.c=c(t),start2.l=l(t),start2.opacity=opacity(t),start2+""}}}function cubehelix2(hue){
return(function cubehelixGamma(y2){y2=+y2;function cubehelix3(start2,end){var h=hue((start2=cubehelix(start2)).
h,(end=cubehelix(end)).h),s2=nogamma(start2.s,end.s),l=nogamma(start2.l,end.l),opacity=nogamma(start2.opacity,
end.opacity);return function(t){return start2.h=h(t),start2.s=s2(t),start2.l=l(Math.pow(t,y2)),start2.opacity=
opacity(t),start2+""}}return cubehelix3.gamma=cubehelixGamma,cubehelix3})(1)}var constant2,rgb2,rgbBasis,rgbBasisClosed,
reA,reB,degrees3,identity,svgNode,interpolateTransformCss,interpolateTransformSvg,epsilon22,zoom2,hsl_default,
hslLong,hcl_default,hclLong,cubehelix_default,cubehelixLong,init_d3_interpolate=__esm({"node_modules/d3-interp\
olate/dist/d3-interpolate.mjs"(){init_d3_color();constant2=x2=>()=>x2;rgb2=(function rgbGamma(y2){var color2=gamma(
y2);function rgb3(start2,end){var r=color2((start2=rgb(start2)).r,(end=rgb(end)).r),g=color2(start2.g,end.g),b=color2(
start2.b,end.b),opacity=nogamma(start2.opacity,end.opacity);return function(t){return start2.r=r(t),start2.g=g(
t),start2.b=b(t),start2.opacity=opacity(t),start2+""}}return rgb3.gamma=rgbGamma,rgb3})(1);rgbBasis=rgbSpline(
basis$1),rgbBasisClosed=rgbSpline(basisClosed);reA=/[-+]?(?:\d+\.?\d*|\.?\d+)(?:[eE][-+]?\d+)?/g,reB=new RegExp(
reA.source,"g"),degrees3=180/Math.PI,identity={translateX:0,translateY:0,rotate:0,skewX:0,scaleX:1,scaleY:1};interpolateTransformCss=
interpolateTransform(parseCss,"px, ","px)","deg)"),interpolateTransformSvg=interpolateTransform(parseSvg,", ",
")",")"),epsilon22=1e-12;zoom2=(function zoomRho(rho,rho2,rho4){function zoom3(p0,p1){var ux0=p0[0],uy0=p0[1],
w0=p0[2],ux1=p1[0],uy1=p1[1],w1=p1[2],dx=ux1-ux0,dy=uy1-uy0,d2=dx*dx+dy*dy,i,S;if(d2<epsilon22)S=Math.log(w1/w0)/
rho,i=function(t){return[ux0+t*dx,uy0+t*dy,w0*Math.exp(rho*t*S)]};else{var d1=Math.sqrt(d2),b0=(w1*w1-w0*w0+rho4*
d2)/(2*w0*rho2*d1),b1=(w1*w1-w0*w0-rho4*d2)/(2*w1*rho2*d1),r0=Math.log(Math.sqrt(b0*b0+1)-b0),r1=Math.log(Math.
sqrt(b1*b1+1)-b1);S=(r1-r0)/rho,i=function(t){var s2=t*S,coshr0=cosh(r0),u=w0/(rho2*d1)*(coshr0*tanh(rho*s2+r0)-
sinh(r0));return[ux0+u*dx,uy0+u*dy,w0*coshr0/cosh(rho*s2+r0)]}}return i.duration=Math.abs(S)*1e3*rho/Math.SQRT2,
i}return zoom3.rho=function(_){var _1=Math.max(.001,+_),_2=_1*_1,_4=_2*_2;return zoomRho(_1,_2,_4)},zoom3})(Math.
SQRT2,2,4);hsl_default=hsl2(hue$1),hslLong=hsl2(nogamma);hcl_default=hcl2(hue$1),hclLong=hcl2(nogamma);cubehelix_default=
cubehelix2(hue$1),cubehelixLong=cubehelix2(nogamma)}});function readPalette(paper=!1){for(let name of NAMES)palette[name]=colour(name,paper)}function shades(layers){
let stiffness=layers.map(({mu_pa:mu})=>Math.log10(mu)),least2=Math.min(...stiffness),decades=Math.max(Math.max(
...stiffness)-least2,1);return stiffness.map(one=>rgb2(palette.soft,palette.stiff)((one-least2)/decades))}function haloed(sheet,{
x:x2,y:y2},shade,width,dash){let places=placesOf(x2,y2);polyline(sheet,[places],palette.halo,width+2),polyline(
sheet,[places],shade,width,dash)}function avoid(places){for(let[px,py]of places){let[left,top]=now.avoided.at(
-1)??[-1/0,0];Math.hypot(px-4-left,py-4-top)>8&&now.avoided.push([px-4,py-4,8,8])}}function labelFree(sheet,words,places,fill){
let{left,top,width,height}=now.view.box,wide=measure(words,"strong")+6,limit=(value,low,high)=>Math.max(low,Math.
min(value,high)),free=places.map(([px,py])=>[limit(px-wide/2,left+2,left+width-wide-2),limit(py-LINE/2,top+2,top+
height-LINE-2),wide,LINE]).filter(one=>!count(now.labels,one)),box=free.find(one=>!count(now.avoided,one))??free[0];
box&&(now.labels.push(box),label(sheet,words,[box[0]+wide/2,box[1]+LINE/2],{fill,font:"strong"}))}function labelBeside(sheet,words,sides,shade){
let half=measure(words,"strong")/2,curves=sides.map(([{x:x2,y:y2},away])=>({places:placesOf(x2,y2),away}));for(let{
places}of curves)avoid(places);let ends=curves.map(({places})=>places[places.length-1]).map(([px,py])=>[px+half+
8,py]),beside=SHARES.flatMap(share=>curves.flatMap(({places,away})=>{let[px,py]=places[Math.round(share*(places.
length-1))];return[0,-half,half].map(aside=>[px+aside,py+away])}));labelFree(sheet,words,[...ends,...beside],shade)}
var NAMES,palette,polyline,polygon,placesOf,traceBetween,cross,traceEllipse,label,LINE,SHARES,clearLabels,overlap,
count,countBelow,nameLine,init_strokes=__esm({"needlefit/viewer/page/painters/strokes.js"(){"use strict";init_d3_shape();
init_d3_interpolate();init_dom();init_sheet();init_store();init_view();NAMES=["air","gutter","ink","quiet","ed\
ge","needle","tip","guide","points","path","load","measured","pinned","band","plan","gap","bad","halo","soft",
"stiff","label","accent"],palette={};polyline=(sheet,lines,stroke,width,dash)=>sheet.path(lines.map(trace).join(
""),{stroke,width,dash}),polygon=(sheet,corners,fill,opacity)=>sheet.path(`${trace(corners)}Z`,{fill,opacity}),
placesOf=(x2,y2)=>Array.from(x2,(one,i)=>[toPx(one),toPy(y2[i])]);traceBetween=(x2,low,high)=>area().x((_,i)=>toPx(
x2[i])).y0((_,i)=>toPy(low[i])).y1((_,i)=>toPy(high[i]))(x2)??"",cross=([px,py],arm,oblique=!1)=>[[arm,oblique?
arm:0],[oblique?-arm:0,arm]].map(([dx,dy])=>[[px-dx,py-dy],[px+dx,py+dy]]),traceEllipse=([px,py],along,across)=>`\
M${px-along},${py}a${along},${across} 0 1 0 ${2*along},0a${along},${across} 0 1 0 ${-2*along},0Z`,label=(sheet,words,place,looks)=>sheet.
text(words,place,{fill:palette.label,halo:palette.halo,...looks}),LINE=16,SHARES=[1,.8,.6,.4],clearLabels=()=>Object.
assign(now,{labels:[],avoided:[]}),overlap=([x2,y2,w,h],[x22,y22,w2,h2])=>x2<x22+w2&&x22<x2+w&&y2<y22+h2&&y22<
y2+h,count=(places,box)=>places.filter(one=>overlap(one,box)).length,countBelow=box=>count([...now.labels,...now.
avoided],box);nameLine=(sheet,words,curve,shade)=>labelBeside(sheet,words,[[curve,16],[curve,-16]],shade)}});function paintTissue(sheet){let{box}=view;sheet.path(traceBox(box),{fill:palette.air});let layers=listLayers();
for(let{from,to,shade}of layers)sheet.path(traceBox({...box,left:from,width:to-from}),{fill:shade});for(let{from,
number:number3,top:edge}of layers){if(edge<box.left)continue;let[fill,width]=number3===1?[palette.ink,1.5]:[palette.
edge,1];sheet.path(traceBox({...box,left:Math.round(from)-.5,width}),{fill})}let axis=Math.round(toPy(0))+.5;polyline(
sheet,[[[box.left,axis],[box.left+box.width,axis]]],palette.quiet,1,[5,4])}function listLayers(){let{boundaries_mm:tops,
layer_names:names}=now.scene,{left,width}=view.box,depths=[0,...tops,1/0];return shades(now.state.layers).map(
(shade,i)=>({shade,number:i+1,name:names[i]||`layer ${i+1}`,mu:now.state.layers[i].mu_pa,top:toPx(depths[i]),from:Math.
max(toPx(depths[i]),left),to:Math.min(toPx(depths[i+1]),left+width)})).filter(({from,to})=>to>from)}function paintNames(sheet){
let{left,top,width}=view.box,layers=listLayers(),write2=(texts,py)=>{let end=-1/0;texts.forEach((text,i)=>{let middle=(layers[i].
from+layers[i].to)/2,half=measure(text,"plain")/2;middle-half<end+APART||(sheet.text(text,[middle,top+py],{fill:palette.
label,font:"plain"}),end=middle+half)})},named2=layers.every(({from,to,name})=>measure(name,"plain")<=to-from);
write2(layers.map(({name,number:number3})=>named2?name:String(number3)),-27),write2(layers.map(({mu})=>`μ ${modulus(
mu)}`),-11);let skin=toPx(0);skin>left+40&&skin<=left+width&&sheet.text("skin",[skin-4,top-11],{fill:palette.label,
font:"plain",align:"end"})}function paintFrame(sheet,name){let{left,top,width,height}=view.box;sheet.path(traceBox(
{left:left-.5,top:top-.5,width:width+1,height:height+1}),{stroke:palette.quiet});let across=ticks(fromPy(top+height),
fromPy(top),Math.max(height/TICKS_APART,2)).map(y2=>[y2,Math.round(toPy(y2))+.5]);polyline(sheet,across.map(([
,py])=>[[left-TICK,py],[left,py]]),palette.quiet,1);for(let[y2,py]of across)sheet.text(written2(y2),[left-TICK-
2,py],{fill:palette.label,align:"end"});sheet.turned([11,top+height/2],QUARTER,()=>sheet.text(name,[0,0],{fill:palette.
label}))}function paintAxes(sheet){let{left,top,width,height}=view.box,bottom=top+height;paintFrame(sheet,nameAcross(
height)),paintNames(sheet);let along=ticks(fromPx(left),fromPx(left+width),width/TICKS_APART).map(x2=>[x2,Math.
round(toPx(x2))+.5]);polyline(sheet,along.map(([,px])=>[[px,bottom],[px,bottom+TICK]]),palette.quiet,1);for(let[
x2,px]of along)sheet.text(written2(x2),[px,bottom+TICK+8],{fill:palette.label});sheet.text("x along the entry \
(mm)",[left+width/2,bottom+31],{fill:palette.label})}function nameAcross(room){if(view.magnified===1)return"y \
(mm)";let long=`y (mm), drawn ${view.magnified}× as large as x`;return measure(long,"small")<room?long:`y (mm\
), drawn ${view.magnified}×`}var APART,TICK,TICKS_APART,QUARTER,written2,init_background=__esm({"needlefit/vi\
ewer/page/painters/background.js"(){"use strict";init_d3_array();init_quantities();init_sheet();init_store();init_view();
init_strokes();APART=8,TICK=5,TICKS_APART=60,QUARTER=Math.PI/2;written2=value=>brief(value,6).replace("-","−")}});function computeValidity(shape,{boundaries,thickness,spacing}){let{x:x2,u,slope:slope4,planes,track}=shape,last4=x2.
length-1,bent=Array.from({length:planes},(_,p)=>[u,slope4].map(one=>one.subarray(p*x2.length,(p+1)*x2.length))),
cubics=bent.map(()=>[0,0,0]),[rotations,missed]=[bent.map(()=>0),bent.map(()=>0)],rotate=t=>(cubics.forEach(([
begin2,bend,curl],p)=>rotations[p]=begin2+t*(bend+t*curl)),measure2(rotations)),steepest=0,shortening=0,miss=0;
for(let i=0;i<=last4;i+=1)steepest=Math.max(steepest,measure2(bent.map(([,one])=>one[i])));for(let i=0;i<last4;i+=
1){let step=x2[i+1]-x2[i];bent.forEach(([v,rotation],p)=>{let mean2=(v[i+1]-v[i])/step,begin2=rotation[i],end=rotation[i+
1];cubics[p]=[begin2,6*mean2-4*begin2-2*end,3*(begin2+end)-6*mean2]});let[[,bend,curl]]=cubics,inside=planes>1?
[.25,.5,.75]:[Math.abs(curl)>1e-12?-.5*bend/curl:0];for(let at of inside)at>0&&at<1&&(steepest=Math.max(steepest,
rotate(at)));for(let[t,weight]of GAUSS){let angle2=rotate(t);shortening+=step*weight*2*Math.sin(angle2/2)**2,x2[i]<
-1e-9&&angle2&&rotations.forEach((one,p)=>missed[p]+=step*weight*one*(1-Math.sin(angle2)/angle2))}miss=Math.max(
miss,measure2(missed))}for(let i=0;i<track.length;i+=2*planes)steepest=Math.max(steepest,measure2(bent.map((_,p)=>track[i+
2*p+1])));let entered=1+boundaries.filter(end=>end<x2[last4]).length,widths=boundaries.slice(0,entered).map((end,i)=>end-
(i?boundaries[i-1]:0)).filter(width=>width>0),thinnest=widths.length?Math.max(Math.min(...widths),spacing):1/0;
return{max_slope:steepest,deflection_per_length:measure2(bent.map(([v])=>Math.max(...v)-Math.min(...v)))/(x2[last4]-
x2[0]),shortening_per_layer:shortening/thinnest,miss_mm:miss,compression:Math.max(...listGaps(shape).map(measure2))/
Math.min(...thickness.slice(0,entered))}}function listGaps({x:x2,u,slope:slope4,planes,constraints}){let i=0;return Array.
from({length:constraints.length/(1+planes)},(_,k2)=>{let[at,...places]=constraints.subarray((1+planes)*k2,(1+planes)*
(k2+1));for(;i<x2.length-2&&x2[i+1]<at-1e-9;)i+=1;let span=x2[i+1]-x2[i],t=Math.min(Math.max((at-x2[i])/span,0),
1);return places.map((place,p)=>{let n=p*x2.length+i,bend=3*(u[n+1]-u[n])-span*(2*slope4[n]+slope4[n+1]),curl=2*
(u[n]-u[n+1])+span*(slope4[n]+slope4[n+1]);return u[n]+t*(span*slope4[n]+t*(bend+t*curl))-place})})}var GAUSS,
measure2,listFaults,init_validity=__esm({"needlefit/viewer/page/model/validity.js"(){"use strict";GAUSS=[[.5-Math.
sqrt(.15),.2777777777777778],[.5,.4444444444444444],[.5+Math.sqrt(.15),.2777777777777778]],measure2=parts=>parts.
length>1?Math.sqrt(parts[0]**2+parts[1]**2):Math.abs(parts[0]);listFaults=(validity,limits)=>limits.filter(([name,
limit])=>!(validity[name]<=limit)).map(([name,limit,words])=>{let unit=name.endsWith("_mm")?" mm":"";return`${words}\
 ${Number(validity[name].toPrecision(3))}${unit} (limit ${limit}${unit})`})}});function describeState(steered){let{scene,session,step,model,names,rules}=steered,{shape}=session,{controls,bevel}=step,
validity=computeValidity(shape,model),[x2,y2,z=null]=columns(session.positions(listStations(shape)),1+shape.planes),
last4=shape.x.length-1,roll2=wrap(rollOf(bevel));return{step:steered.number,depth_mm:step.depth,x:x2,y:y2,z,...placePoints(
session),base:{x:x2[0],y:y2[0],rotation:shape.slope[0],input_y:controls.baseY,input_slope:controls.baseSlope},
guides:controls.guides.map(({name,x:x3,y:y3,slope:slope4})=>({item:guideNumber(name,names),name,x:x3,y:y3,slope:slope4??
0,turns_freely:slope4===null})),tip:{x:x2[x2.length-1],y:y2[y2.length-1],z:z&&z[z.length-1],rotation:shape.slope[last4],
lateral_mm:y2[y2.length-1],held:controls.tip!==null,input_y:shape.u[last4]},bevel:{side:Math.abs(roll2)>90?-1:
1,roll_deg:roll2,...describeStrength(bevel,model)},layers:model.mu.map((mu,layer)=>({mu_pa:mu*1e6,...Object.fromEntries(
scene.shape_parameters.map(({name},row)=>[name,steered.shape[row][layer]]))})),max_slope:validity.max_slope,faults:listFaults(
validity,rules.validity),errors:scene.measured&&computeErrors(session,scene.measured)}}function placePoints(session){
let{planes,constraints,track}=session.shape,cut=columns(constraints,1+planes),[x2,...needle]=columns(session.positions(
cut[0]),1+planes),gaps=columns(listGaps(session.shape).flat(),planes),tip=columns(track,2*planes),points=needle.
map((row,p)=>row.map((place,i)=>place-gaps[p][i])),path2=points.map((row,p)=>row.map((place,i)=>place+tip[2*p][i]-
cut[1+p][i])),curve=([y2,z])=>({x:x2,y:y2,z});return{constraints:curve(points),tip_path:curve(path2)}}function describeLoad({
session,model}){let{depth,planes}=session.shape,count2=Math.ceil(SAMPLES*depth/model.spacing),s2=Array.from({length:count2+
1},(_,i)=>depth*(i/(count2||1))),[x2,y2]=columns(session.positions(s2),1+planes),loads=session.load(s2),means=Array.
from({length:planes},(_,p)=>loads.subarray(p*s2.length,(p+1)*s2.length)).map(row=>{let sums=[0];for(let value of row)
sums.push(sums[sums.length-1]+value);return s2.map((_,i)=>{let half=Math.min(SAMPLES,i,count2-i);return(sums[i+
half+1]-sums[i-half])/(2*half+1)})});return{x:x2,y:y2,load:planes===1?means[0]:means[0].map((one,i)=>Math.hypot(
one,means[1][i]))}}function listStations({x:x2,depth}){let end=Math.min(0,depth),before=Array.from({length:POINTS_BEFORE_TISSUE},
(_,i)=>x2[0]+(end-x2[0])*i/(POINTS_BEFORE_TISSUE-1));return before[POINTS_BEFORE_TISSUE-1]=end,Float64Array.from(
new Set([...before,...x2])).sort()}var POINTS_BEFORE_TISSUE,SAMPLES,columns,describeStrength,init_state=__esm(
{"needlefit/viewer/page/model/state.js"(){"use strict";init_inputs();init_errors();init_validity();POINTS_BEFORE_TISSUE=
25,SAMPLES=8,columns=(points,width)=>Array.from({length:width},(_,axis)=>Array.from({length:points.length/width},
(_2,i)=>points[width*i+axis])),describeStrength=({offset,cutAngle},{pathAngle})=>pathAngle?{cut_angle_deg:cutAngle*
(180/Math.PI)}:{offset_mm:offset}}});function paintNeedle(sheet,{x:x2,y:y2,faults,bevel:{side}}){let points=placesOf(x2,y2),tip=points[points.length-
1],shaft=points.filter(one=>distance(one,tip)>BEVEL.length),last4=shaft.at(-1)??tip,share=1-BEVEL.length/(distance(
last4,tip)||1),end=last4.map((from,i)=>from+share*(tip[i]-from));polyline(sheet,[[...shaft,end]],faults.length?
palette.bad:palette.needle,LINE2,faults.length?[9,5]:[]);let size2=distance(end,tip)||1,[dx,dy]=tip.map((to,i)=>BEVEL.
half*(to-end[i])/size2),aside=([px,py],to)=>[px+to*dy,py-to*dx],[back,near2,point2]=[aside(end,-side),aside(end,
side),aside(tip,side)];polygon(sheet,[back,near2,point2],palette.needle),polyline(sheet,[[back,point2]],palette.
tip,2)}function paintPoints(sheet,{constraints:{x:x2,y:y2}}){let half=Math.min(Math.max(CROSS.of*now.scene.spacing_mm*
view.scale,CROSS.least),CROSS.most);polyline(sheet,placesOf(x2,y2).flatMap(place=>cross(place,half,!0)),palette.
points,1.2),nameLine(sheet,"constraint points",{x:x2,y:y2},palette.points)}function paintPath(sheet,{tip_path:path2}){
polyline(sheet,[placesOf(path2.x,path2.y)],palette.path,1.5),nameLine(sheet,"tip path",path2,palette.path)}function paintLoad(sheet){
let{x:x2,y:y2,load:load2}=describeLoad(now.steered),greatest=max(load2,Math.abs);if(!greatest)return;let[,top]=nice(
0,greatest,1),{box}=view,tall=Math.min(TALLEST,.2*box.height-10),shaft=placesOf(x2,y2),edge=shaft.map(([px,py],i)=>[
px,py-tall*load2[i]/top]);polygon(sheet,[...shaft,...edge.toReversed()],palette.load,.32),polyline(sheet,[edge],
palette.load,1.25);let[left,high]=[box.left+10,box.top+6],ends=[high,high+tall].map(py=>[[left-4,py],[left+4,py]]);
polyline(sheet,[[[left,high],[left,high+tall]],...ends],palette.load,1.5);let words=`load ${brief(top)} N/mm`;
now.labels.push([left-4,high,measure(words,"small")+16,tall]),label(sheet,words,[left+8,high+tall/2],{fill:palette.
load,align:"start"})}function paintBase(sheet,{base}){let[px,py]=[toPx(base.x),toPy(base.y)],ends=[-46,46].map(
to=>[[px-5,py+to],[px+5,py+to]]);polyline(sheet,[[[px,py-46],[px,py+46]],...ends],palette.quiet,2),sheet.turned(
[px,py],angleOf(Math.tan(base.rotation)),()=>sheet.path("M-22,-7h26v14h-26Z",{fill:palette.ink}))}function paintGuides(sheet,{
guides}){for(let guide of guides){let[px,py]=[toPx(guide.x),toPy(guide.y)];sheet.turned([px,py],angleOf(guide.
slope),()=>{for(let to of[-1,1]){let d=guide.turns_freely?`M0,${GAP*to}l-7,${11*to}h14Z`:`M-13,${GAP*to}h26v${7*
to}h-26Z`;sheet.path(d,{fill:palette.guide})}}),px>=view.box.left&&px<=view.box.left+view.box.width&&labelFree(
sheet,shortName(guide),[[px,py+27]],palette.guide)}}var LINE2,BEVEL,GAP,CROSS,TALLEST,angleOf,distance,init_needle2=__esm(
{"needlefit/viewer/page/painters/needle.js"(){"use strict";init_d3_array();init_state();init_quantities();init_sheet();
init_store();init_view();init_strokes();LINE2=2.5,BEVEL={length:7.5,half:1.5},GAP=3,CROSS={of:.28,least:1,most:3.2},
TALLEST=36,angleOf=slope4=>Math.atan(slope4*view.magnified),distance=(one,other)=>Math.hypot(one[0]-other[0],one[1]-
other[1])}});function paintMeasured(sheet,curve){let[place]=placesOf(curve.x,curve.y);isTip(curve)?sheet.path(traceEllipse(
place,DOT,DOT),{fill:palette.halo,stroke:palette.measured,width:2}):haloed(sheet,curve,palette.measured,2,[7,4]),
nameLine(sheet,isTip(curve)?"measured tip":"measured",curve,palette.measured)}function paintPinned(sheet,pinned){
haloed(sheet,pinned,palette.pinned,2.5,[2,3]),nameLine(sheet,"pinned",pinned,palette.pinned)}function nameNeedle(sheet,state){
predictionOf(state,now.scene)||nameLine(sheet,isSteered(state,now.scene)?"steered":"simulated",state,state.faults.
length?palette.bad:palette.needle)}function nameBand(sheet,{x:x2,low,high}){isChanged(now.state,now.scene)&&labelBeside(
sheet,"band of the fit",[[{x:x2,y:high},-14],[{x:x2,y:low},14]],palette.band)}function paintBand(sheet,{x:x2,low,
high},pale){sheet.path(traceBetween(x2,low,high),{fill:palette.band,opacity:pale?.16:.4});for(let edge of[low,
high])polyline(sheet,[placesOf(x2,edge)],palette.band,pale?.75:1.5)}function paintPrediction(sheet,state){let prediction=predictionOf(
state,now.scene);prediction&&(haloed(sheet,prediction,palette.accent,2.5),nameLine(sheet,"prediction",prediction,
palette.accent))}function heightAt({x:xs,y:ys},x2){let after=Math.min(Math.max(bisectLeft(xs,x2),1),xs.length-
1),share=Math.min(Math.max((x2-xs[after-1])/(xs[after]-xs[after-1]),0),1);return ys[after-1]+share*(ys[after]-
ys[after-1])}function paintGaps(sheet,state,measured){let{errors}=state;if(!errors)return;let prediction=predictionOf(
state,now.scene),needle=prediction??state,[tip,other]=[needle,measured].map(({x:x2,y:y2})=>({x:x2[x2.length-1],
y:y2[y2.length-1]})),reach=Math.min(tip.x,other.x),across=x2=>[needle,measured].map(curve=>[toPx(x2),toPy(heightAt(
curve,x2))]),places=isTip(measured)?[]:range(1,GAPS).map(n=>reach*n/GAPS);polyline(sheet,places.map(across),palette.
gap,1.25);let ends=errors.whole?[tip,other].map(({x:x2,y:y2})=>[toPx(x2),toPy(y2)]):across(reach);for(let[shade,
width]of[[palette.halo,5],[palette.gap,2.5]])polyline(sheet,[ends],shade,width);let px=ends[1][0],[top,bottom]=extent(
ends,([,py])=>py),beside=[0,60,-90].flatMap(aside=>[top-AWAY,bottom+AWAY].map(py=>[px+aside,py]));labelFree(sheet,
`tip error (TE) ${(prediction?.errors??errors).te_mm.toFixed(2)} mm`,beside,palette.gap)}function paintPlan(sheet,{
target:[x2,y2],radius,obstacles,needles}){for(let[xs,ys]of needles)sheet.path(trace(placesOf(xs,ys)),{stroke:palette.
plan,opacity:FAN});for(let[along,across,size2,name]of obstacles)paintCircle(sheet,along,across,size2,palette.tip,
name,.28);paintCircle(sheet,x2,y2,radius,palette.guide,"target"),polyline(sheet,cross([toPx(x2),toPy(y2)],CROSS2),
palette.guide,2)}function paintCircle(sheet,x2,y2,radius,shade,name,opacity=0){let[px,size2]=[toPx(x2),radius*
view.scale],edge=traceEllipse([px,toPy(y2)],size2,size2*view.magnified);sheet.path(edge,{fill:shade,opacity}),
sheet.path(edge,{stroke:palette.halo,width:4}),sheet.path(edge,{stroke:shade,width:2}),!(px<view.box.left||px>
view.box.left+view.box.width)&&labelFree(sheet,name,[[px,toPy(y2+radius)-12],[px,toPy(y2-radius)+12]],shade)}function paintInset(sheet,{
x:x2,y:y2}){let points=range(x2.length).filter(i=>x2[i]>=0);if(points.length<2)return;let{box}=view,{diameter_mm:thick}=now.
scene,[first,last4]=[x2[points[0]],x2[x2.length-1]],[low,high]=extent(points,i=>y2[i]),scale=Math.min(INSET.width*
box.width/(last4-first+thick),INSET.height*box.height/(high-low+thick)),size2={width:(last4-first+thick)*scale+
2*INSET.edge,height:(high-low+thick)*scale+INSET.edge+INSET.title},corners=[box.top+box.height-size2.height-INSET.
edge,box.top+INSET.edge].flatMap(top=>[box.left+INSET.edge,box.left+box.width-size2.width-INSET.edge].map(left=>({
left,top,...size2}))),frame2=least(corners,({left,top})=>countBelow([left,top,size2.width,size2.height]));now.
labels.push([frame2.left,frame2.top,size2.width,size2.height]),sheet.path(traceBox(frame2),{fill:palette.air,stroke:palette.
quiet});let place=i=>[frame2.left+INSET.edge+(x2[i]-first+thick/2)*scale,frame2.top+INSET.title+(high-y2[i]+thick/
2)*scale];polyline(sheet,[points.map(place)],palette.needle,Math.max(thick*scale,1)),label(sheet,"true scale",
[frame2.left+6,frame2.top+INSET.title/2],{align:"start"})}var GAPS,FAN,CROSS2,DOT,AWAY,BAND_REACH,INSET,isTip,
isBandNear,init_overlay=__esm({"needlefit/viewer/page/painters/overlay.js"(){"use strict";init_d3_array();init_quantities();
init_sheet();init_store();init_view();init_strokes();GAPS=12,FAN=.3,CROSS2=5,DOT=4,AWAY=19,BAND_REACH=2,INSET=
{width:.3,height:.25,edge:10,title:16};isTip=({x:x2})=>x2.length===1;isBandNear=({x:x2},state)=>x2.length>0&&Math.
abs(x2[x2.length-1]-state.tip.x)<=BAND_REACH}});function listShown(){let{state,shown,scene,band,pinned}=now;return{state,band:shown.band&&band&&isBandNear(band,
state)?band:null,measured:shown.measured?scene.measured:null,pinned:shown.pinned?pinned:null}}function paintCurves(sheet,{
state,band,measured,pinned},below=()=>{},above=()=>{}){let{shown}=now;sheet.within(view.box,()=>{paintTissue(sheet),
band&&paintBand(sheet,band,band.step!==state.step),below(),pinned&&paintPinned(sheet,pinned),paintNeedle(sheet,
state),shown.path&&paintPath(sheet,state),shown.points&&paintPoints(sheet,state),measured&&paintMeasured(sheet,
measured),above()})}function begin(sheet,[width,height]){sheet.path(`M0,0h${width}v${height}h${-width}Z`,{fill:palette.
gutter}),clearLabels()}function paintPicture(sheet,size2){let{shown,scene:{plan}}=now,seen=listShown(),{state,
band,measured,pinned}=seen;begin(sheet,size2);for(let curve of[state,measured,pinned])curve&&avoid(placesOf(curve.
x,curve.y));paintCurves(sheet,seen,()=>{shown.load&&!state.faults.length&&paintLoad(sheet),shown.plan&&plan&&paintPlan(
sheet,plan)},()=>{paintPrediction(sheet,state),measured&&shown.errors&&paintGaps(sheet,state,measured),paintGuides(
sheet,state),paintBase(sheet,state),(measured||pinned)&&nameNeedle(sheet,state),band&&nameBand(sheet,band),shown.
inset&&paintInset(sheet,state)}),paintAxes(sheet)}function paintAbove(sheet,[width,height]){let{state,band,measured,
pinned}=listShown();begin(sheet,[width,height]);let seen={state:{...turn(state),constraints:turn(state.constraints),
tip_path:turn(state.tip_path),bevel:{...state.bevel,side:Math.sin(state.bevel.roll_deg*Math.PI/180)<0?-1:1}},band:band?.
z?{...band,...band.z}:null,measured:measured&&turn(measured),pinned:pinned&&turn(pinned)},heights2=[seen.state,
seen.measured,seen.pinned].flatMap(curve=>curve?.y??[]),[low,high]=extent([...heights2,...seen.band?[...seen.band.
low,...seen.band.high]:[],0]),box={...view.box,top:EDGE,height:height-2*EDGE},magnified=Math.min(view.magnified,
(box.height-2*ROOM2)/(view.scale*(high-low||1)));look({y:(low+high)/2,box,magnified},()=>{paintCurves(sheet,seen,
void 0,()=>label(sheet,"from above",[box.left+6,EDGE+10],{align:"start"})),paintFrame(sheet,magnified===1?"z (\
mm)":`z (mm), drawn ${brief(magnified,2)}×`)})}var EDGE,ROOM2,isSpatial,turn,init_picture=__esm({"needlefit/v\
iewer/page/painters/picture.js"(){"use strict";init_d3_array();init_quantities();init_store();init_view();init_background();
init_needle2();init_overlay();init_strokes();[EDGE,ROOM2]=[8,14],isSpatial=()=>!!(now.state?.z??now.scene?.measured?.
compared==="space");turn=curve=>({...curve,y:curve.z??curve.x.map(()=>0)})}});function makeSheet(on){let[width,height]=[on.clientWidth,on.clientHeight].map(one=>Math.round(one*devicePixelRatio));
(on.width!==width||on.height!==height)&&Object.assign(on,{width,height});let context=getContext(on);return context.
setTransform(devicePixelRatio,0,0,devicePixelRatio,0,0),new Screen(context)}function draw(){if(frame=0,now.state){
let above=part("above");above.hidden=!isSpatial(),above.hidden||paintAbove(makeSheet(above),[above.clientWidth,
above.clientHeight]),paintPicture(makeSheet(canvas),size()),document.body.classList.add("begun")}publish("draw\
n")}var NOTCHES,canvas,frame,size,last,init_drawing=__esm({"needlefit/viewer/page/drawing.js"(){"use strict";init_dom();
init_picture();init_strokes();init_sheet();init_store();init_view();NOTCHES=[300,10,2],canvas=part("canvas"),frame=
0,size=()=>[canvas.clientWidth,canvas.clientHeight];listen("redraw",()=>frame||=requestAnimationFrame(draw));listen(
"state",()=>(follow(),redraw()));listen("band",redraw);new ResizeObserver(()=>resize(...size())).observe(part(
"picture"));new ResizeObserver(redraw).observe(part("above"));onScheme(()=>(readPalette(),redraw()));readPalette();
last=[0,0];canvas.addEventListener("pointerdown",({pointerId})=>canvas.setPointerCapture(pointerId));canvas.addEventListener(
"pointermove",({buttons,pointerType,offsetX,offsetY})=>{buttons===1&&pointerType!=="touch"&&pan(offsetX-last[0],
offsetY-last[1]),last=[offsetX,offsetY]});canvas.addEventListener("wheel",event=>{document.activeElement!==canvas&&
!event.ctrlKey||(event.preventDefault(),zoom(2**(-event.deltaY/NOTCHES[event.deltaMode]),[event.offsetX,event.
offsetY]))},{passive:!1});canvas.addEventListener("dblclick",()=>fit("tissue"))}});async function unpack(id){let bytes=Uint8Array.from(atob(part(id).textContent),one=>one.charCodeAt(0)),stream=new Blob(
[bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));return new Response(stream).arrayBuffer()}
async function load(){let[data,kernel]=await Promise.all([unpack("data"),unpack("kernel").then(compile)]),{lists,
...read}=JSON.parse(new TextDecoder().decode(data));for(let{scene:{draws}}of read.needles)for(let name in draws)
draws[name]=lists[draws[name]?.$]??draws[name];return{...read,kernel}}function insert(steered){for(let changes of steered.
scene.simulation.changes)steered.apply(changes)}function compareStored(steered,{errors:known,tip},same){let{scene:{
measured},session}=steered;if(!known||!measured?.stored)return Math.abs(steered.tipLateral-Number(tip));let{x:x2,
y:y2,z}=measured.stored,[points]=readTarget(session,measured.target),computed=computeErrors(session,measured),
errors=Object.keys(known).map(name=>Math.abs(known[name]-computed?.[name]));return Math.max(...points.flatMap(
(point2,i)=>[x2,y2,z].map((axis,n)=>Math.abs(point2[n]-axis[i]))),...errors.filter(one=>one>same))}async function prove({
needles,kernel},same){let[count2,largest,since]=[0,0,performance.now()],rest=async()=>{performance.now()-since<
SLICE||(await new Promise(done=>setTimeout(done)),since=performance.now())};for(let needle of needles){let compare=distance2=>{
count2+=1,largest=Math.max(largest,distance2)};try{let steered=await SteeredNeedle.begin(kernel,needle.scene);
if(needle.recording){let replay=new Replay(steered,needle.recording);for(let n=1;n<=needle.recording.length;n+=
1)replay.to(n),compare(Math.abs(steered.tipLateral-needle.recording[n-1][2])),await rest()}else{if(insert(steered),
needle.tip===null)continue;compare(compareStored(steered,needle,same))}}catch(error){if(!(error instanceof ModelError))
throw error;compare(NaN)}await rest()}return{count:count2,largest}}var SLICE,Replay,init_stored=__esm({"needle\
fit/viewer/page/stored.js"(){"use strict";init_needle();init_dom();init_errors();init_inputs();init_steered();
SLICE=12;Replay=class{at=0;changed=!1;last=new Map;constructor(steered,steps2,places=[],unit="s"){this.steered=
steered,this.steps=steps2,this.places=places,this.unit=unit,steps2.forEach(([,changes],i)=>{for(let[name,,value]of changes)
name==="return_to"&&this.last.set(value,i+1)})}to(n){for((this.changed||n<this.at)&&(this.steered.rewind(),Object.
assign(this,{at:0,changed:!1}));this.at<n;)this.#next()}#next(){let[,changes]=this.steps[this.at];this.steered.
apply(changes),this.at+=1,this.last.has(this.at)&&this.steered.keep();for(let[name,,value]of changes)name==="r\
eturn_to"&&this.last.get(value)===this.at&&this.steered.forget(value)}}}});function refuse(error,below=part("flip").parentElement){if(!(error instanceof ModelError))throw error;below.after(
refusal),write(refusal,`${error.what}. Expected: ${error.expected}.`)}function show(){steps+=1,part("undo").disabled=
!past.length,part("redo").disabled=!future.length,take("state",{...describeState(now.steered),step:steps})}function forgetPast(){
for(let one of[past,future])one.length=0;last2=0,write(refusal,"")}function goHome(){forgetPast(),now.steered.
rewind();try{insert(now.steered)}catch(error){refuse(error)}show()}function steer(lists,{gesture=newGesture(),
whole=!1,below}={}){let{steered}=now,{number:number3}=steered;publish("steers"),write(refusal,"");let begins=gesture!==
last2;(begins||whole)&&steered.keep();try{for(let changes of lists)steered.apply(changes.map(([name,item,value])=>[
name,item,value+0]))}catch(error){if(refuse(error,below),whole&&steered.number>number3&&steered.apply([["retur\
n_to",null,number3]]),whole||steered.number===number3)return void publish("unchanged")}begins&&(past.push(number3),
future.length=0,past.length>MOST_UNDONE&&steered.forget(Number(past.shift()))),last2=gesture,part("back").disabled=
!1,show()}function goTo(from,to){let number3=from.pop();if(number3===void 0)return;publish("steers"),write(refusal,
"");let{steered}=now;steered.keep(),to.push(steered.number),steered.apply([["return_to",null,number3]]),last2=
0,show()}var MOST_UNDONE,refusal,past,future,steps,gestures,last2,newGesture,change,undo,redo,init_steering=__esm(
{"needlefit/viewer/page/steering.js"(){"use strict";init_dom();init_inputs();init_state();init_stored();init_store();
MOST_UNDONE=200,refusal=part("refusal"),[past,future]=[[],[]],[steps,gestures,last2]=[0,0,0],newGesture=()=>gestures+=
1;change=(changes,how)=>steer([changes],how);undo=()=>goTo(past,future),redo=()=>goTo(future,past)}});async function followAddress(choose2){let address=location.hash.slice(1);if(!address)return!1;let{needles}=now.
data,below=part("proof").parentElement;try{if(part(decode(address)))return!1;let name=nameIn(address),number3=needles.
findIndex(one=>nameOf2(one)===name);if(name!==null&&number3<0)throw new ModelError(`the address has needle=${name}`,
needles.map(nameOf2).join(", "));number3>=0&&needles[number3]!==now.needle&&await choose2(number3);let lists=readAddress(
address,now.scene);return lists.length&&steer(lists,{below,whole:!0}),lists.length>0}catch(error){return refuse(
error,below),!0}}function decode(address){try{return decodeURIComponent(address)}catch{throw new ModelError(`t\
he address ends with #${address}, which is no text`,"depth=, in mm, as Copy link writes it")}}async function copy(){
let{data:{needles,kernel},needle,scene,steered}=now,address=await writeAddress(kernel,steered,needles.length>1?
nameOf2(needle):null);write("link-note",address?"":"No link: an address carries depth, roll and turns of the b\
evel, and parameters. A recording carries all inputs."),address&&(steer(readAddress(address,scene)),history.replaceState(
null,"",`#${address}`),await navigator.clipboard?.writeText(location.href).then(()=>write("link-note","The lin\
k is copied."),()=>null))}var nameOf2,init_link=__esm({"needlefit/viewer/page/link.js"(){"use strict";init_address();
init_dom();init_inputs();init_steering();init_store();nameOf2=({name,scene})=>name??scene.measured?.id??scene.
title;press("copy-link",copy)}});var DEFINITIONS,define2,init_definitions=__esm({"needlefit/viewer/page/definitions.js"(){"use strict";init_dom();
init_store();DEFINITIONS={depth:"Inserted arc length: how much of the needle is beyond the entry.","tip y":"Di\
stance of the tip from the entry axis, y; positive to the left of the entry.","tip slope":"Angle of the needle\
 at its tip against the entry axis.","steepest slope":"Largest slope dy/dx of the needle; the model takes it f\
or small.",roll:"Roll of the bevel from here on, about x: 0 turns the cut toward +y, 90 toward +z, ±180 toward\
 −y.","tip z":"Distance of the tip from the plane of the entry axis and y.","base y":"Lateral displacement o\
f the base of the needle, as it is set; positive to the left.","base slope":"Angle of the base of the needle a\
gainst the entry axis, as it is set.",guide:"Where a guide holds the needle: x along the entry, y to its left,\
 slope dy/dx as an angle.","noise floor":"The mean error that perfect parameters would still show if measureme\
nts err as stated."};listen("scene",({definitions,shape_parameters:shapes})=>{Object.assign(DEFINITIONS,definitions);
for(let{symbol,explanation}of shapes)DEFINITIONS[symbol]=`${explanation[0].toUpperCase()}${explanation.slice(1)}\
.`});define2=(name,called=name)=>name in DEFINITIONS?element("span",{className:"term",title:DEFINITIONS[name]},
called):called}});function fillReadouts(list,readouts){let numbers=readouts.map(([name,unit])=>{let number3=element("span",{},"–");
return list.append(entry(define2(name),[number3," ",element("small",{},unit)])),number3});return from=>readouts.
forEach(([,,read],i)=>write(numbers[i],from?read(from):"–"))}function refresh(){let{state,scene}=now;writeNeedle(
state),part("readouts").children[TIP_Z].hidden=!state.z;let title=part("title"),follows=scene.plan&&!now.replay?.
changed;if(title&&write(title,`${follows?"plan: ":isSteered(state,scene)?"steered by hand: ":""}${scene.title}`),
!scene.measured)return;let prediction=predictionOf(state,scene);writeErrors(state.errors&&{...state.errors,...prediction?.
errors}),write("against",`${prediction?"prediction ":""}against ${scene.measured.id}${state.errors?`, ${comparedUpTo(
state.errors)}`:""}`)}function inWords(){let{state,scene}=now;if(!state)return"The needle has not been drawn y\
et.";let{tip,bevel,base,guides,errors}=state,held=guides.length===1?"1 guide":`${guides.length} guides`,{symbol,
value,digits:digits2,unit}=strengthOf(bevel),sentences=[`The needle is ${state.depth_mm.toFixed(1)} mm deep, o\
f ${scene.length_mm.toFixed(0)} mm.`,`Its tip is ${Math.abs(tip.lateral_mm).toFixed(2)} mm to the ${tip.lateral_mm<
0?"right":"left"}${tip.held?" and held there":""}, at ${angle(tip)}${tip.z===null?"":`; z ${signed(tip.z,2)} m\
m`}.`,`The bevel turns the cut toward ${describeRoll(bevel)}, ${symbol} is ${value.toFixed(digits2)} ${unit}.`,
`The base stands at y ${signed(base.y,2)} mm, at ${angle(base)}; ${held}.`];if(exceeded(state)&&sentences.push(
`The needle is ${exceeded(state)}.`),errors){let prediction=predictionOf(state,scene);sentences.push(`${prediction?
"The prediction against":"Against"} the measured needle ${comparedUpTo(errors)}: ${listErrors(prediction?.errors??
errors,scene.measured).join(", ")}.`)}return sentences.join(" ")}var NEEDLE,TIP_Z,writeNeedle,writeErrors,comparedUpTo,
exceeded,angle,init_readouts=__esm({"needlefit/viewer/page/readouts.js"(){"use strict";init_definitions();init_dom();
init_quantities();init_store();init_view();NEEDLE=[["depth","mm",s2=>s2.depth_mm.toFixed(2)],["tip y","mm",s2=>signed(
s2.tip.lateral_mm,2)],["tip z","mm",s2=>s2.tip.z===null?"–":signed(s2.tip.z,2)],["tip slope","°",s2=>signed(
toDegrees(s2.tip.rotation),2)],["steepest slope","",s2=>s2.max_slope.toFixed(3)]],TIP_Z=NEEDLE.findIndex(([name])=>name===
"tip z");writeNeedle=fillReadouts(part("readouts"),NEEDLE),writeErrors=_errors=>{};comparedUpTo=({whole,upto_mm:upto})=>whole?
"over the whole insertion":`over the first ${upto.toFixed(1)} mm`;listen("scene",({measured})=>{if(part("compa\
red").hidden=measured===null,!measured)return;let metrics=measured.metrics.map(([name,label2,unit])=>[label2,unit,
errors=>writeError(errors[name],unit)]);for(let[,label2,,text]of measured.metrics)DEFINITIONS[label2]=text;part(
"errors").replaceChildren(),writeErrors=fillReadouts(part("errors"),[...metrics,["noise floor","mm",({floor_mm:floor})=>writeError(
floor,"mm")]])});exceeded=({faults})=>faults?.length?`outside the model: ${faults.join("; ")}`:"";listen("stat\
e",state=>{refresh(),write("described",inWords());let words=exceeded(state);write("beyond",words&&`${words[0].
toUpperCase()}${words.slice(1)}. Its shape cannot be relied on.`),part("beyond").classList.toggle("low",toPy(state.
tip.y)<view.box.top+view.box.height/2)});angle=({rotation})=>`${signed(toDegrees(rotation),1)} degrees`}});function drawFigure(wide,begin2){let[across,tall]=size(),{box,scale}=view,width=wide*PX_PER_MM,share=(width-(across-
box.width))/box.width,height=tall-box.height+share*box.height,above=isSpatial()?part("above").clientHeight:0,sheet=begin2(
[width,height+above]);return readPalette(!0),look({scale:scale*share,box:{...box,width:share*box.width,height:share*
box.height}},()=>{above&&sheet.turned([0,height],0,()=>paintAbove(sheet,[width,above])),paintPicture(sheet,[width,
height])}),readPalette(),redraw(),sheet}function drawPng(wide){let canvas2=document.createElement("canvas"),times=DPI/
96;return drawFigure(wide,([width,height])=>{Object.assign(canvas2,{width:Math.round(times*width),height:Math.
round(times*height)});let context=getContext(canvas2);return context.scale(times,times),new Screen(context)}),
new Promise(resolve=>canvas2.toBlob(resolve,"image/png"))}function drawSvg(wide){let{svg}=drawFigure(wide,figure=>new Figure(
figure,wide,now.scene.title,inWords()));return new Blob([new XMLSerializer().serializeToString(svg)],{type:"im\
age/svg+xml"})}var PX_PER_MM,DPI,init_figure=__esm({"needlefit/viewer/page/figure.js"(){"use strict";init_dom();
init_drawing();init_link();init_picture();init_strokes();init_readouts();init_sheet();init_store();init_view();
PX_PER_MM=96/25.4,DPI=300;press("save-figure",async()=>{if(!now.state)return;let[format,wide]=[part("figure-fo\
rmat").value,Number(part("figure-width").value)],figure=await(format==="png"?drawPng(wide):drawSvg(wide)),name=`${nameOf2(
now.needle).replace(/[^\w-]+/g,"-")}.${format}`;figure&&(hand(figure,name),write("link-note",`Saved ${name}: t\
he picture as it is shown.`))});for(let[kind,on]of[["beforeprint",!0],["afterprint",!1]])addEventListener(kind,
()=>{readPalette(on),draw()})}});var template,STEPS,THUMB,LINEAR,LOGARITHMIC,ARROWS,SLIDES,made,Field,init_fields=__esm({"needlefit/viewer/page\
/fields.js"(){"use strict";init_definitions();init_dom();init_steering();template=part("field-template"),STEPS=
1e3,THUMB=16,LINEAR=[x2=>x2,x2=>x2],LOGARITHMIC=[x2=>Math.log(Math.max(x2,Number.MIN_VALUE)),Math.exp],ARROWS=
{ArrowUp:1,ArrowDown:-1},SLIDES={...ARROWS,ArrowRight:1,ArrowLeft:-1,PageUp:10,PageDown:-10},made=0,Field=class{value=null;home=null;latest=0;editing=!1;gesture=newGesture();constructor(into,about){
let{name,symbol=name,unit,limits=[0,1],logarithmic}=about,[to,from]=logarithmic?LOGARITHMIC:LINEAR,[low,high]=limits.
map(to);this.about=about,this.part=template.content.firstElementChild?.cloneNode(!0);let find=kind=>this.part.
querySelector(`.${kind}`);this.number=find("number"),this.slider=find("slider"),this.mark=find("mark"),this.back=
find("home"),this.share=value=>Math.min(Math.max((to(value)-low)/(high-low),0),1);let{number:number3,slider,back}=this;
made+=1,number3.id=`field-${made}`,number3.setAttribute("aria-description",DEFINITIONS[symbol]),number3.ariaLabel=
slider.ariaLabel=name+(unit&&`, ${unit}`),back.ariaLabel=`${number3.ariaLabel}: back to its initial value`,find(
"name").append(define2(symbol,name)),find("unit").textContent=unit,slider.max=STEPS,about.limits||find("track").
remove(),this.#hear(),slider.addEventListener("input",()=>this.#ask(from(low+slider.value/STEPS*(high-low)))),
slider.addEventListener("change",()=>this.gesture=newGesture()),this.setHome(null),into.append(this.part)}show(value){
if(value===this.value)return;let{number:number3,slider,about:{unit,write:write2}}=this;this.value=this.latest=
value,this.editing||this.#giveBack(),slider.value=Math.round(STEPS*this.share(value)),slider.ariaValueText=`${write2(
value)} ${unit}`.trim(),this.#markHome()}setHome(home){let{mark,back,about:{unit,write:write2}}=this;this.home=
home,back.hidden=mark.hidden=home===null,home!==null&&(mark.style.left=`calc(${THUMB/2}px + ${this.share(home)}\
 * (100% - ${THUMB}px))`,back.title=`back to ${write2(home)} ${unit}`.trim(),this.#markHome())}#markHome(){let{
home,value,about:{write:write2}}=this;this.back.disabled=home===null||value===null||write2(home)===write2(value)}#ask(value){
this.latest=value,this.value=null,this.about.ask(value,{gesture:this.gesture,below:this.part})}#read(){return(this.
about.read??Number)(this.number.value)}#hear(){let{number:number3,slider,back}=this;number3.addEventListener("\
input",()=>this.editing=!0),number3.addEventListener("blur",()=>this.#giveBack()),number3.addEventListener("ch\
ange",()=>{if(number3.value==="")return this.#giveBack();this.gesture=newGesture(),this.editing=!1,this.#ask(this.#read())}),
number3.addEventListener("keydown",event=>{this.#step(ARROWS[event.key],event),event.key==="Escape"&&this.#giveBack()}),
number3.addEventListener("keyup",({key})=>{key==="Enter"&&(this.editing=!1)}),slider.addEventListener("keydown",
event=>this.#step(SLIDES[event.key],event)),press(back,()=>{this.gesture=newGesture(),this.home!==null&&this.#ask(
this.home)})}#giveBack(){let{number:number3,value,about:{write:write2}}=this;this.editing=!1,value!==null&&number3.
value!==write2(value)&&(number3.value=write2(value))}#step(count2,event){if(!count2)return;event.preventDefault();
let{step,logarithmic}=this.about,from=this.editing&&this.number.value!==""?this.#read():this.latest;this.editing=
!1,event.repeat||(this.gesture=newGesture()),this.#ask(logarithmic?from*step**count2:from+step*count2)}}}});function buildFields({scene,recording}){fields=[];for(let id of["insertion-fields","guide-fields","tissue-fiel\
ds","shape-fields"])part(id).replaceChildren();let{limits,fitted,simulation,layer_names:names,shape_parameters:shapes}=scene,
{steps:[first],law}=simulation,add=(into,input,item,about,read,home)=>{let[shown,meant]=input.endsWith("slope")?
[degrees,slope]:[x2=>x2,x2=>x2],field=new Field(part(into),{...about,ask:(value2,how)=>change([[input,item,meant(
value2)]],how)});home!==void 0&&field.setHome(shown(home)),fields.push([field,()=>shown(read(now.state))])},addInput=(input,about,read,home)=>add(
"insertion-fields",input,null,{...about,symbol:about.name},read,recording?void 0:home);addInput("depth_mm",{...MM,
name:"depth",step:1,write:digits(1),limits:[0,limits.depth_mm-.01]},s2=>s2.depth_mm,scene.depth_mm),addInput("\
base_y_mm",{...MM,name:"base y",limits:[-10,10]},s2=>s2.base.input_y,first.controls.baseY),addInput("base_slop\
e",{...TILT,name:"base slope",limits:[-5,5]},s2=>s2.base.input_slope,first.controls.baseSlope),addInput("bevel\
_roll_deg",{name:"roll",unit:"°",step:10,limits:[-180,180],write:value2=>brief(value2,6)},s2=>s2.bevel.roll_deg,
rollOf(first.bevel)),first.controls.guides.forEach((guide,i)=>{let item=i+1,addGuide=(axis,about)=>add("guide-\
fields",`guide_${axis}${axis==="slope"?"":"_mm"}`,item,{...about,name:`guide ${shortName({item,name:guide.name})}\
, ${axis}`,symbol:"guide"},s2=>(s2.guides.find(one=>one.item===item)??guide)[axis]??0,recording?void 0:guide[axis]??
0);addGuide("x",{...MM,name:""}),addGuide("y",{...MM,name:"",write:digits(3)}),guide.slope!==null&&addGuide("s\
lope",{...TILT,name:""})}),part("guide-part").hidden=!first.controls.guides.length;let{symbol,unit,digits:count2,
step,here,throughout,value}=strengthOf(fitted);if(!recording?.some(([,changes])=>changes.some(([name])=>name===
here))){let about={name:symbol,symbol,unit,step,write:digits(count2),limits:limits[symbol==="b"?"offset_mm":"c\
ut_angle_deg"]};add("tissue-fields",throughout,null,about,s2=>strengthOf(s2.bevel).value,value)}part("shape-pa\
rt").hidden=!law.terms||!shapes.length,fitted.layers.forEach((layer,i)=>{let called=names[i]||`layer ${i+1}`,about={
...modulusLike(layer.mu_pa),name:`μ ${called}`,symbol:"μ",logarithmic:!0,step:1.05,limits:limits.mu_pa};add(
"tissue-fields","mu_pa",i+1,about,s2=>s2.layers[i].mu_pa,layer.mu_pa);for(let{name,symbol:symbol2,unit:unit2}of law.
terms?shapes:[]){let[low,high]=limits[name];add("shape-fields",name,i+1,{name:`${symbol2} ${called}`,symbol:symbol2,
unit:unit2,step:Math.min(.1,(high-low)/100),write:digits(2),limits:[low,high]},s2=>s2.layers[i][name],layer[name])}})}
function refresh2(){for(let[field,read]of fields)field.show(read());part("side").textContent=describeRoll(now.
state.bevel)}var digits,fields,MM,TILT,init_inputs2=__esm({"needlefit/viewer/page/inputs.js"(){"use strict";init_dom();
init_fields();init_inputs();init_quantities();init_steering();init_store();digits=count2=>value=>value.toFixed(
count2),fields=[],MM={unit:"mm",step:.1,write:digits(2)},TILT={unit:"°",step:.1,write:digits(2)};for(let kind of[
"state","unchanged"])listen(kind,refresh2)}});function pin(){let{x:x2,y:y2,z}=now.state;setPinned(now.pinned?null:{x:x2,y:y2,z})}function setPinned(pinned){
now.pinned=pinned,part("pin").ariaPressed=String(!!pinned),write("pin",pinned?"Unpin":"Pin");let{measured,draws,
plan}=now.scene,there={measured,errors:measured,band:draws,plan,pinned,points:!0,path:!0,load:!0,inset:!0};NAMES2.
forEach((name,i)=>chips[i].hidden=!there[name]),redraw()}var CHIPS,NAMES2,fits,chips,init_toolbar=__esm({"need\
lefit/viewer/page/toolbar.js"(){"use strict";init_dom();init_store();init_view();CHIPS={measured:["measured"],
errors:["errors","Gaps at the tip (TE) and along the shaft (IPE)"],band:["95 % band","95 % of the needles lie \
wholly inside"],plan:["plan"],pinned:["pinned"],points:["constraint points","What holds the needle in the tiss\
ue: points of the model, not data"],path:["tip path","Where the tip was at each depth"],load:["load","Lateral \
load of the tissue on the shaft, within the limits of the model"],inset:["true scale","The needle in a corner,\
 with y as large as x"]},NAMES2=Object.keys(CHIPS),fits=document.querySelectorAll("[data-fit]"),chips=NAMES2.map(
name=>{let[called,title=""]=CHIPS[name],swatch=element("i",{ariaHidden:"true",className:`swatch ${name}`}),chip=element(
"button",{type:"button",title,ariaPressed:String(now.shown[name])},swatch,called);return chip.dataset.show=name,
press(chip,()=>{now.shown[name]=!now.shown[name],chip.ariaPressed=String(now.shown[name]),redraw()}),chip});part(
"chips").append(...chips);press("pin",pin);for(let one of fits)press(one,()=>fit(one.dataset.fit));listen("sce\
ne",()=>setPinned(null));listen("redraw",()=>fits.forEach(one=>one.ariaPressed=String(one.dataset.fit===view.fit)))}});function go(key,changes){let at=performance.now(),again=key===last3.key&&at-last3.at<WITHIN;Object.assign(last3,
{key,at,gesture:again?last3.gesture:newGesture()}),change(changes,{gesture:last3.gesture})}function insert2(mm){
let{step:{depth},scene}=now.steered,end=Math.max(Math.min(now.steered.reach(),scene.limits.depth_mm),depth);go(
"insert",[["depth_mm",null,Math.min(Math.max(depth+mm,0),end)]])}function hear(event){if(!now.state||event.altKey)
return;let key=event.key.length===1?event.key.toLowerCase():event.key,act=event.ctrlKey||event.metaKey?COMMANDS[key]:
KEYS.find(([keys])=>keys.includes(key))?.[3];act&&(event.preventDefault(),act(event))}var ROLL,WITHIN,last3,flip,
roll,moveBase,KEYS,COMMANDS,init_keyboard=__esm({"needlefit/viewer/page/keyboard.js"(){"use strict";init_dom();
init_inputs();init_steering();init_store();init_toolbar();init_view();ROLL=10,WITHIN=1e3,last3={key:"",at:-1/0,
gesture:0};flip=()=>change([turnOver(now.state.bevel.roll_deg)]),roll=by=>go("roll",[["bevel_roll_deg",null,wrap(
now.state.bevel.roll_deg+by)]]),moveBase=mm=>go("base",[["base_y_mm",null,now.state.base.input_y+mm]]),KEYS=[[
["ArrowRight"],"→","insert 1 mm; with Shift 0.1 mm",e=>insert2(e.shiftKey?.1:1)],[["ArrowLeft"],"←","retra\
ct, likewise",e=>insert2(e.shiftKey?-.1:-1)],[["ArrowUp"],"↑","base up by 0.1 mm; with Shift by 1 mm",e=>moveBase(
e.shiftKey?1:.1)],[["ArrowDown"],"↓","base down, likewise",e=>moveBase(e.shiftKey?-1:-.1)],[["f"],"F","flip \
the bevel",flip],[["r"],"R",`roll the bevel by ${ROLL}°; with Shift back`,e=>roll(e.shiftKey?-ROLL:ROLL)],[["\
k"],"K","pin this needle to compare with, or unpin",pin],[["+","="],"+","zoom in; a drag shifts, a double clic\
k shows the tissue",()=>zoom(1.25)],[["-"],"−","zoom out",()=>zoom(.8)],[["1"],"1","show the whole needle",()=>fit(
"whole")],[["2"],"2","show the tissue",()=>fit("tissue")],[["3"],"3","follow the tip",()=>fit("tip")]],COMMANDS=
{z:event=>event.shiftKey?redo():undo(),y:()=>redo()};for(let[written3,what]of[...KEYS.map(([,key,effect])=>[key,
effect]),["Ctrl+Z, Y","undo, redo"]])part("key-list").append(entry(element("kbd",{},written3),what));part("can\
vas").addEventListener("keydown",hear);press("undo",undo);press("redo",redo);press("flip",flip)}});function goBack(){write("link-note",""),part("back").disabled=!0,now.replay?showPlace(now.replay,now.replay.places.
at(-1)??0):goHome()}function showPlace(replay,place){let{places,unit}=replay,end=places.at(-1)??0;forgetPast(),
replay.to(places.filter(one=>one<=place).length),scrub.value=String(place>=end?scrub.max:place),scrub.ariaValueText=
`${place.toFixed(1)} ${unit}`,write("time",`${place.toFixed(1)} of ${end.toFixed(1)} ${unit}`),show()}function openRecording(recording,planned=!1){
if(part("transport").hidden=!recording,now.replay=null,!recording)return;let places=recording.map(([time,changes])=>planned?
changes.find(([name])=>name==="depth_mm")?.[2]??0:time);now.replay=new Replay(now.steered,recording,places,planned?
"mm of the plan":"s of the recording"),scrub.max=String(Math.ceil(10*(places.at(-1)??0))/10),scrub.ariaLabel=planned?
"depth along the plan, mm":"time of the recording, s"}function readRecording(text){let lines=text.split(/\r?\n/),
count2=lines.findIndex(one=>!one.startsWith("#")),number3=now.data.needles.findIndex(({head})=>head&&identify(
head)===identify(text));if(count2<1||lines[count2]!==COLUMNS)throw new ModelError("the file is no recording","\
a file of Save recording, or of needlefit plan");if(number3<0)throw new ModelError("the recording is of anothe\
r scene","one of this page; needlefit view --recording opens others");let steps2=[];for(let row of lines.slice(
count2+1).filter(Boolean)){let[step,time,name,item,value,tip]=row.split(",");Number(step)>steps2.length&&steps2.
push([Number(time),[],NaN]);let last4=steps2[steps2.length-1];last4[1].push([name,item?Number(item):null,Number(
value)]),tip&&(last4[2]=Number(tip))}return{number:number3,steps:steps2}}function openDropped(choose2){addEventListener(
"dragover",event=>event.preventDefault()),addEventListener("drop",async event=>{event.preventDefault();let[file]=event.
dataTransfer?.files??[];if(file)try{let{number:number3,steps:steps2}=readRecording(await file.text());await choose2(
number3),openRecording(steps2),goBack(),write("link-note",`Opened ${file.name}.`)}catch(error){refuse(error,part(
"proof").parentElement)}})}function keep(){let{needle,steered}=now,text=JSON.stringify({head:needle.head,way:steered.
listWay().map(({changes})=>changes)});try{text.length<=MOST_KEPT&&localStorage.setItem(keyOf(needle),text)}catch{}}
function restore(){let{needle,steered,replay}=now,kept=JSON.parse(localStorage.getItem(keyOf(needle))??"null");
if(!kept||kept.head!==needle.head)return!1;steered.rewind();try{for(let changes of kept.way)steered.apply(changes)}catch{
return localStorage.removeItem(keyOf(needle)),goBack(),!1}return replay&&(replay.changed=!0),part("back").disabled=
!1,write("link-note","The needle as you left it: this browser keeps it."),show(),!0}var PAUSE,MOST_KEPT,scrub,
COLUMNS,identify,keyOf,keeping,init_recording=__esm({"needlefit/viewer/page/recording.js"(){"use strict";init_address();
init_dom();init_link();init_inputs();init_steering();init_store();init_stored();PAUSE=400,MOST_KEPT=1e6,scrub=
part("scrub"),COLUMNS="step,time_s,input,item,value,tip_lateral_mm";scrub.addEventListener("input",()=>{let{replay}=now;
replay&&showPlace(replay,Math.min(Number(scrub.value),replay.places.at(-1)??0))});press("back",()=>{localStorage.
removeItem(keyOf(now.needle)),goBack()});listen("steers",()=>{now.replay&&(now.replay.changed=!0)});press("sav\
e-recording",()=>{let name=`${nameOf2(now.needle).replace(/[^\w-]+/g,"-")}.csv`;hand(new Blob([writeRecording(
now.needle.head??"",now.steered)],{type:"text/csv"}),name),write("link-note",`Saved ${name}. It opens on this \
page, and with: needlefit view --recording ${name}`)});identify=head=>head.split(`
`).filter(one=>one.startsWith("#")).slice(1).filter(one=>!one.startsWith("# needlefit =")).join(`
`);keyOf=needle=>`needlefit ${location.pathname} ${nameOf2(needle)}`,keeping=0;listen("steers",()=>{clearTimeout(
keeping),keeping=setTimeout(keep,PAUSE)});addEventListener("pagehide",()=>keeping&&keep())}});var main_exports={};async function choose(number3){let{data}=now;part("needle-choice").value=number3;let steered=await SteeredNeedle.
begin(data.kernel,data.needles[number3].scene);if(Number(part("needle-choice").value)!==number3)return;let needle=data.
needles[number3];Object.assign(now,{needle,steered,band:null});let{scene}=needle;openRecording(needle.recording,
!!needle.scene.plan),take("scene",scene),buildFields(needle);let specimen=needle.new_specimen?" (of a specimen\
 that was not fitted)":"",draws=counted(scene.draws?.sets??0,"posterior draw");write("band-note",scene.draws?`\
Band: 95 % of the needles of ${draws}${specimen} lie wholly in it. Noise and model error are not included.`:""),
part("origin-mark")&&write("origin-mark",scene.origin_mark),goBack()}async function stateAgreement(){let{data}=now,
{count:count2,largest}=await prove(data,SAME),[what,of]=data.needles[0].recording?["recorded state","recording"]:
["needle",data.title?"report":"program"],[agrees,place]=[largest<SAME,part("proof")],found=largest===0?`the sa\
me bytes as in the ${of}`:`up to ${largest.toExponential(1)} mm from the ${of}`;place.className=`quiet ${agrees?
"good":"bad"}`,place.dataset.count=count2,place.dataset.largest=largest;let checked=`Self-check ${agrees?"pass\
ed":"failed"}: ${counted(count2,what)} computed here`;write("proof",`${checked}, ${Number.isNaN(largest)?"one \
without a result":found} (needlefit ${data.needlefit}).`)}async function start(){let data=now.data=await load(),
script=new Blob([part("program").textContent],{type:"text/javascript"});computeBands(new Worker(URL.createObjectURL(
script)));let choice=part("needle-choice");choice.append(...data.needles.map((one,i)=>element("option",{value:String(
i)},[nameOf2(one),one.group].filter(Boolean).join(", ")))),part("choosing").hidden=data.needles.length<2,choice.
addEventListener("change",()=>choose(Number(choice.value))),addEventListener("hashchange",()=>followAddress(choose)),
openDropped(choose),await choose(0),await followAddress(choose)||restore(),await stateAgreement()}var init_main=__esm(
{"needlefit/viewer/page/main.js"(){"use strict";init_address();init_bands();init_dom();init_figure();init_inputs2();
init_keyboard();init_link();init_steered();init_quantities();init_recording();init_store();init_stored();start().
catch(error=>{throw write("proof",`The needle was not computed: ${error.message}`),part("proof").classList.add(
"bad"),error})}});typeof document>"u"?Promise.resolve().then(()=>(init_band_worker(),band_worker_exports)):Promise.resolve().then(()=>(init_main(),main_exports));})();
